"""The numbers of a parametric body, and what can be computed from them without torch."""

from __future__ import annotations

import dataclasses

import numpy as np

from .kinematics import joint_transforms, skinning_transforms

SMPL_BODY_JOINTS = 22  # pelvis to wrists: the joints SMPL, SMPL-H and SMPL-X share, in the same order


@dataclasses.dataclass(frozen=True)
class BodyData:
    """An SMPL-family body: template, shape directions, skeleton, skinning weights, UV atlas.

    v_template: (V, 3) metres, y-up. shapedirs: (V, 3, B) metres per beta. J_regressor: (J, V).
    parents: (J,) int, root -1. lbs_weights: (V, J), rows sum to 1. faces: (F, 3) int vertex indices.
    uv: (U, 2) in [0, 1], v up. uv_faces: (F, 3) int indices into uv. joint_names: J names.
    posedirs: (V, 3, 9 (J-1)) pose blendshapes in metres per rotation-matrix entry, or None.
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

    @property
    def num_joints(self) -> int:
        return len(self.parents)

    @property
    def num_betas(self) -> int:
        return self.shapedirs.shape[2]

    def shaped(self, betas: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(V, 3) rest vertices and (J, 3) rest joints of a body with shape `betas` ((B,) or shorter; None = mean)."""
        betas = np.zeros(0) if betas is None else np.asarray(betas).reshape(-1)[: self.num_betas]
        vertices = self.v_template + self.shapedirs[:, :, : len(betas)] @ betas
        return vertices, self.J_regressor @ vertices

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

    def posed(self, poses: np.ndarray, betas: np.ndarray | None = None, trans=None) -> tuple[np.ndarray, np.ndarray]:
        """(V, 3) vertices and (J, 3) joints of one pose (J, 3), skinned from the rest shape; trans (3,) is added.

        Pose blendshapes are not applied here: bodies that have them pose through their own component.
        """
        vertices, joints = self.shaped(betas)
        T = joint_transforms(poses, joints, self.parents)
        A = skinning_transforms(T, joints)
        blended = np.einsum("vj,jab->vab", self.lbs_weights, A)
        posed = np.einsum("vab,vb->va", blended[:, :3, :3], vertices) + blended[:, :3, 3]
        trans = np.zeros(3) if trans is None else np.asarray(trans)
        return posed + trans, T[:, :3, 3] + trans


def check_motion_fits(poses: np.ndarray, num_joints: int) -> np.ndarray:
    """Poses (T, Jm, 3) brought to a body of `num_joints`: missing joints (hands) are filled with zero, surplus cut."""
    T, J = poses.shape[:2]
    if num_joints <= J:
        return poses[:, :num_joints]
    return np.concatenate([poses, np.zeros((T, num_joints - J, 3), poses.dtype)], 1)
