"""Joints that a motion never moves, folded into their parents: fewer transforms a frame and fewer weights a point."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..geometry.rotations import matrix_from_axis_angle
from ..values.surface import Surface

SAME = 1e-6  # of a rotation matrix: float32 angles of the same pose agree to that


@dataclasses.dataclass(frozen=True, eq=False)
class Folded:
    """A surface for the poses of one motion, carried by the joints alone that the motion moves.

    surface: on those M joints. moving: (M,) their numbers. still: (J,) bool, the others. held: (J - M, 3) float32
    axis-angle in which the motion holds those.
    """

    surface: Surface
    moving: np.ndarray
    still: np.ndarray
    held: np.ndarray

    @classmethod
    def of(cls, surface: Surface, poses: np.ndarray) -> Folded | None:
        """For poses (F, J, 3), F at least 1; None where every joint moves."""
        still = still_joints(surface, poses)
        if not still.any():
            return None
        return cls(*folded(surface, still), still, np.asarray(poses[0], np.float32)[still])

    def fits(self, pose: np.ndarray) -> bool:
        """Whether a pose (J, 3) holds the joints that rest as the motion does."""
        return np.array_equal(pose[self.still], self.held)


def still_joints(surface: Surface, poses: np.ndarray) -> np.ndarray:
    """(J,) bool: joints that all `poses` (F, J, 3) hold as in the canonical pose, so that their transform is their
    parent's. One that is bent there is left out if a joint below it moves. Never the root."""
    parents = np.asarray(surface.parents)
    R = matrix_from_axis_angle(np.asarray(poses, np.float64))
    world = surface.A_canonical[:, :3, :3]
    still = np.zeros(len(parents), bool)
    straight = np.zeros(len(parents), bool)
    for j, parent in enumerate(parents):
        if parent >= 0:
            canonical = world[parent].T @ world[j]
            still[j] = np.abs(R[:, j] - canonical).max(initial=0.0) < SAME
            straight[j] = np.abs(canonical - np.eye(3)).max() < SAME
    for j in range(len(parents) - 1, -1, -1):  # children stand behind their parents
        below = np.flatnonzero(parents == j)
        still[j] &= straight[j] or bool(still[below].all())
    return still


def folded(surface: Surface, still: np.ndarray) -> tuple[Surface, np.ndarray]:
    """The surface on the joints that move, and their numbers (M,): where the `still` joints (J,) are held as in the
    canonical pose, `skin_transforms` of the others' pose and its weights give every point the same place."""
    parents = np.asarray(surface.parents)
    kept = np.flatnonzero(~still)
    carrier = np.arange(len(parents))
    for j, parent in enumerate(parents):
        if still[j]:
            carrier[j] = carrier[parent]
    place = np.full(len(parents), -1)
    place[kept] = np.arange(len(kept))
    new_parents = np.array([-1 if parents[j] < 0 else place[carrier[parents[j]]] for j in kept], np.int32)
    index, weight = _merged(place[carrier[surface.joint_index]], surface.joint_weight)
    small = dataclasses.replace(
        surface,
        joint_index=index,
        joint_weight=weight,
        joints=surface.joints[kept],
        parents=new_parents,
        A_canonical=surface.A_canonical[kept],
    )
    return small, kept


def _merged(index: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the same joint added up, in as few columns as the fullest row needs, the largest first."""
    slots = index.shape[1]
    weight = weight.astype(np.float32).copy()
    for k in range(slots):
        for earlier in range(k):
            same = (index[:, earlier] == index[:, k]) & (weight[:, k] > 0)
            weight[same, earlier] += weight[same, k]
            weight[same, k] = 0
    order = np.argsort(-weight, 1, kind="stable")
    weight = np.take_along_axis(weight, order, 1)
    index = np.where(weight > 0, np.take_along_axis(index, order, 1), 0)
    used = max(1, int((weight > 0).any(0).sum()))
    return np.ascontiguousarray(index[:, :used], np.int32), np.ascontiguousarray(weight[:, :used])
