"""The body reduced to what a live fit needs: 22 joints, 33 landmarks, and bones as long as the person's."""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar_runtime.values.body import SMPL_BODY_JOINTS, BodyData

from ..preparation.landmarks import INDEX, fold_hands, landmark_rows

_SIDES = ("left", "right")
# Lengths that a landmark network's points in space tell: the ends of each, an end being the middle of its points.
_ENDS: dict[str, list[tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "trunk": [(("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"))],
    "shoulders": [(("left_shoulder",), ("right_shoulder",))],
    "hips": [(("left_hip",), ("right_hip",))],
    **{
        name: [((f"{side}_{a}",), (f"{side}_{b}",)) for side in _SIDES]
        for name, a, b in (("upper_arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist"), ("thigh", "hip", "knee"),
                           ("shin", "knee", "ankle"))
    },
}  # fmt: skip
MEASURED = tuple(_ENDS)
# The bones that end in a joint grow by the factor of a length. What is not here grows as the trunk does.
_BONES = {
    "hip": "hips", "knee": "thigh", "ankle": "shin", "foot": "shin", "collar": "trunk", "shoulder": "shoulders",
    "elbow": "upper_arm", "wrist": "forearm",
}  # fmt: skip
SHORTEST, LONGEST = 0.75, 1.3  # of a bone of the mean body: adults and half-grown children


@dataclasses.dataclass(frozen=True, eq=False)
class LiveSkeleton:
    """names: 22 joints. parents: (22,) int. joints: (22, 3) at rest, metres. points: (33, 3) landmarks at rest.
    carrier: (33,) int, the joint that each landmark is fixed to. above: (33, 22) bool, whether a joint moves a
    landmark."""

    names: tuple[str, ...]
    parents: np.ndarray
    joints: np.ndarray
    points: np.ndarray
    carrier: np.ndarray
    above: np.ndarray

    @classmethod
    def of(cls, body: BodyData) -> LiveSkeleton:
        """Of a body's mean shape. A landmark is fixed to the one joint that holds most of it."""
        regressor, weights = landmark_rows(body)
        parents = np.asarray(body.parents[:SMPL_BODY_JOINTS], int)
        carrier = fold_hands(weights, body.parents).argmax(1)
        chain = np.eye(SMPL_BODY_JOINTS, dtype=bool)
        for j in range(1, SMPL_BODY_JOINTS):
            chain[j] |= chain[parents[j]]
        joints = (body.J_regressor @ body.v_template)[:SMPL_BODY_JOINTS]
        names = tuple(body.joint_names[:SMPL_BODY_JOINTS])
        return cls(names, parents, joints, regressor @ body.v_template, carrier, chain[carrier])

    @staticmethod
    def lengths(points: np.ndarray) -> np.ndarray:
        """(..., 7) of `MEASURED`, metres, mean of both sides. points: (..., 33, 3)."""

        def middle(names: tuple[str, ...]) -> np.ndarray:
            return points[..., [INDEX[name] for name in names], :].mean(-2)

        rows = [[np.linalg.norm(middle(a) - middle(b), axis=-1) for a, b in pairs] for pairs in _ENDS.values()]
        return np.stack([np.mean(row, 0) for row in rows], -1)

    @staticmethod
    def visible(visibility: np.ndarray) -> np.ndarray:
        """(7,) least visibility (33,) of the points that each of `MEASURED` is taken from."""
        return np.array([min(visibility[INDEX[n]] for a, b in pairs for n in (*a, *b)) for pairs in _ENDS.values()])

    def scaled(self, factors: np.ndarray) -> LiveSkeleton:
        """With bones of other lengths. factors: (7,) in the order of `MEASURED`, kept between SHORTEST and LONGEST."""
        factor = dict(zip(MEASURED, np.clip(factors, SHORTEST, LONGEST), strict=True))
        grown = np.array([factor[_BONES.get(name.rpartition("_")[2], "trunk")] for name in self.names])
        joints = np.empty_like(self.joints)
        joints[0] = self.joints[0]
        for j in range(1, len(joints)):
            joints[j] = joints[self.parents[j]] + grown[j] * (self.joints[j] - self.joints[self.parents[j]])
        # what a joint carries beyond itself grows as the bone towards it
        offset = self.points - self.joints[self.carrier]
        points = joints[self.carrier] + grown[self.carrier][:, None] * offset
        return dataclasses.replace(self, joints=joints, points=points)

    def posed(self, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """World rotations (22, 3, 3), joints (22, 3) and landmarks (33, 3) of local rotations (22, 3, 3), the pelvis
        where it rests."""
        R, p = np.empty_like(rotations), np.empty_like(self.joints)
        R[0], p[0] = rotations[0], self.joints[0]
        for j in range(1, len(R)):
            k = self.parents[j]
            R[j] = R[k] @ rotations[j]
            p[j] = p[k] + R[k] @ (self.joints[j] - self.joints[k])
        arms = (self.points - self.joints[self.carrier])[..., None]
        return R, p, p[self.carrier] + (R[self.carrier] @ arms)[..., 0]
