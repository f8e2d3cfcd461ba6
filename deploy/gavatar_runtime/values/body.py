"""The numbers of a parametric body, and what can be computed from them without torch."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.kinematics import joint_transforms, skinning_transforms
from ..geometry.rotations import matrix_from_axis_angle
from ..geometry.skinning import whole_weights

SMPL_BODY_JOINTS = 22  # pelvis to wrists: the joints SMPL, SMPL-H and SMPL-X share, in the same order
FACE_JOINTS = ("jaw", "left_eye_smplhf", "right_eye_smplhf")  # of SMPL-X, between body and hands


@dataclasses.dataclass(frozen=True)
class Hands:
    """What a model knows of hand poses (MANO, Romero et al. 2017). First the left hand, then the right.

    mean: (2, 15, 3) axis-angle of a hand at rest, radians. components: (2, K, 45) principal components of hand poses
    about it, K = 0 where there are none. relative: a hand pose given to `BodyData.full_pose` is about the mean, and the
    mean is what a hand does that no motion moves; otherwise both are about the flat hand.
    """

    mean: np.ndarray
    components: np.ndarray
    relative: bool = False

    def pose(self, side: int, values: np.ndarray, *, pca: bool, relative: bool) -> np.ndarray:
        """(..., 15, 3) axis-angle of the left (0) or right (1) hand. values: (..., K), as `motion.HandParameters` has
        them, about the mean hand if `relative`. Raises ValueError for more coefficients than there are components."""
        components = self.components[side]
        if pca:
            if values.shape[-1] > len(components):
                raise ValueError(f"{len(components)} hand components, not {values.shape[-1]}")
            values = values @ components[: values.shape[-1]]
        return values.reshape(*values.shape[:-1], 15, 3) + (self.mean[side] if relative else 0)


@dataclasses.dataclass(frozen=True)
class BodyData:
    """An SMPL-family body: template, shape directions, skeleton, skinning weights, UV atlas.

    v_template: (V, 3) metres, y-up. shapedirs: (V, 3, B) metres per beta. J_regressor: (J, V).
    parents: (J,) int, root -1. lbs_weights: (V, J), rows sum to 1 (what storage took from
    the sum is given back, more raises WrongValue: `whole_weights`). faces: (F, 3) int vertex indices.
    uv: (U, 2) in [0, 1], v up. uv_faces: (F, 3) int indices into uv. joint_names: J names.
    posedirs: (V, 3, 9 (J-1)) pose blendshapes in metres per rotation-matrix entry, or None. exprdirs: (V, 3, E) metres
    per expression coefficient, or None. hands: of bodies with 15 joints a hand at the end of their list, or None.
    """

    name: str
    v_template: np.ndarray
    shapedirs: np.ndarray
    J_regressor: np.ndarray
    parents: np.ndarray
    lbs_weights: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    joint_names: tuple[str, ...]
    posedirs: np.ndarray | None = None
    exprdirs: np.ndarray | None = None
    hands: Hands | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "lbs_weights", whole_weights(self.lbs_weights, f"body '{self.name}'"))

    @property
    def num_joints(self) -> int:
        return len(self.parents)

    @property
    def num_betas(self) -> int:
        return self.shapedirs.shape[2]

    @property
    def num_expression(self) -> int:
        return 0 if self.exprdirs is None else self.exprdirs.shape[2]

    @property
    def rest_pose(self) -> np.ndarray:
        """(J, 3) axis-angle of joints that no motion moves: zero, but for hands that rest in their mean pose."""
        pose = np.zeros((self.num_joints, 3))
        if self.hands is not None and self.hands.relative:
            pose[-30:] = self.hands.mean.reshape(30, 3)
        return pose

    def shaped(self, betas: np.ndarray | None, expression: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(V, 3) rest vertices and (J, 3) rest joints of a body with shape `betas` ((B,) or shorter; None = mean) and
        expression coefficients (E,) or shorter. Coefficients beyond the model's are left out."""
        vertices = self.v_template
        for coefficients, directions in ((betas, self.shapedirs), (expression, self.exprdirs)):
            if coefficients is not None and directions is not None:
                values = np.asarray(coefficients).reshape(-1)[: directions.shape[2]]
                vertices = vertices + directions[:, :, : len(values)] @ values
        return vertices, self.J_regressor @ vertices

    def pose_offsets(self, poses: np.ndarray) -> np.ndarray:
        """(..., V, 3) metres, the pose blendshapes of `poses` (..., J, 3), in the rest pose (SMPL, Loper et al. 2015,
        equation 9); zero without `posedirs`."""
        if self.posedirs is None:
            return np.zeros((*poses.shape[:-2], *self.v_template.shape))
        feature = matrix_from_axis_angle(poses[..., 1:, :]) - np.eye(3)
        directions = self.posedirs.reshape(-1, self.posedirs.shape[2])
        offsets = feature.reshape(-1, directions.shape[1]) @ directions.T
        return offsets.reshape(*poses.shape[:-2], *self.v_template.shape)

    def full_pose(
        self, global_orient: ArrayLike | None = None, body_pose: ArrayLike | None = None, *,
        jaw: ArrayLike | None = None, left_eye: ArrayLike | None = None, right_eye: ArrayLike | None = None,
        left_hand: ArrayLike | None = None, right_hand: ArrayLike | None = None, pca: bool = False,
    ) -> np.ndarray:  # fmt: skip
        """(..., J, 3) axis-angle of every joint from the parts that SMPL-family files keep apart, each of them zero
        where None. Leading axes are a batch.

        global_orient: (..., 3). body_pose: (..., 3 K), the joints from the first hip on, 21 (23 of SMPL with its two
        hand joints). jaw, left_eye, right_eye: (..., 3). left_hand, right_hand: (..., 45) axis-angle, or (..., n)
        coefficients of the first n principal components with `pca`; about the mean hand if `hands.relative`.
        Raises ValueError for a part that the body lacks.
        """
        face = dict(zip(FACE_JOINTS, (jaw, left_eye, right_eye), strict=True))
        parts = [global_orient, body_pose, *face.values(), left_hand, right_hand]
        batch = np.broadcast_shapes(*(np.shape(part)[:-1] for part in parts if part is not None))
        pose = np.broadcast_to(self.rest_pose, (*batch, self.num_joints, 3)).copy()
        if global_orient is not None:
            pose[..., 0, :] = global_orient
        if body_pose is not None:
            body = np.asarray(body_pose)
            pose[..., 1 : 1 + body.shape[-1] // 3, :] = body.reshape(*body.shape[:-1], -1, 3)
        for name, value in face.items():
            if value is not None:
                if name not in self.joint_names:
                    raise ValueError(f"body '{self.name}' has no joint '{name}'")
                pose[..., self.joint_names.index(name), :] = value
        for side, value in enumerate((left_hand, right_hand)):
            if value is not None:
                start = self.num_joints - 30 + 15 * side
                pose[..., start : start + 15, :] = self._hand(side, np.asarray(value), pca)
        return pose

    def _hand(self, side: int, value: np.ndarray, pca: bool) -> np.ndarray:
        if self.hands is None:
            raise ValueError(f"body '{self.name}' has no hands")
        try:
            return self.hands.pose(side, value, pca=pca, relative=self.hands.relative)
        except ValueError as error:
            raise ValueError(f"body '{self.name}' has {error}") from None

    def canonical_pose(self) -> np.ndarray:
        """(J, 3) the canonical pose: all zero but the hips, spread by 30 degrees about z (paper's supplement;
        keeps the legs' surfaces apart so that offsets of one leg never skin with the other)."""
        pose = np.zeros((self.num_joints, 3))
        pose[self.joint_names.index("left_hip"), 2] = np.pi / 6
        pose[self.joint_names.index("right_hip"), 2] = -np.pi / 6
        return pose

    def skinning(self, poses: np.ndarray, betas: np.ndarray | None = None) -> np.ndarray:
        """(..., J, 4, 4) rest-to-posed transforms for `poses` (..., J, 3)."""
        _, joints = self.shaped(betas)
        return skinning_transforms(joint_transforms(poses, joints, self.parents), joints)

    def posed(
        self,
        poses: np.ndarray,
        betas: np.ndarray | None = None,
        trans: np.ndarray | None = None,
        expression: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(..., V, 3) vertices and (..., J, 3) joints of poses (..., J, 3), pose blendshapes included.

        betas: (B,), expression: (E,), one for all poses. trans: (..., 3) metres, added.
        """
        vertices, joints = self.shaped(betas, expression)
        T = joint_transforms(poses, joints, self.parents)
        A = skinning_transforms(T, joints)[..., :3, :]
        blended = (self.lbs_weights @ A.reshape(*A.shape[:-2], 12)).reshape(*A.shape[:-3], -1, 3, 4)
        if self.posedirs is not None:
            vertices = vertices + self.pose_offsets(np.asarray(poses))
        posed = np.einsum("...vab,...vb->...va", blended[..., :3], vertices) + blended[..., 3]
        trans = np.zeros(3) if trans is None else np.asarray(trans)
        return posed + trans[..., None, :], T[..., :3, 3] + trans[..., None, :]


def check_motion_fits(poses: np.ndarray, num_joints: int) -> np.ndarray:
    """Poses (T, Jm, 3) brought to a body of `num_joints`: missing joints (hands) are filled with zero, surplus cut."""
    T, J = poses.shape[:2]
    if num_joints <= J:
        return poses[:, :num_joints]
    return np.concatenate([poses, np.zeros((T, num_joints - J, 3), poses.dtype)], 1)
