"""Pose blendshapes of an avatar's surface as it moves: what the body's skin does beside skinning (SMPL, Loper et al.
2015, equation 9). The canonical surface has those of the canonical pose; added here is the difference to the live one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from ..bundle import Bundle
from ..geometry.rotations import matrix_from_axis_angle
from ..values.array_rules import FAR, Rule, checked, sums_to_one
from ..values.surface import Surface

MEMBER = "pose_blendshapes.npz"
STILL = 1e-6  # entries of a joint's rotation that differ by less from the canonical pose's move nothing
RULES = {  # of N points between V vertices, and T joints that turn: all but the root
    "directions": Rule(("T", 9, "V", 3), low=-FAR, high=FAR),
    "canonical": Rule(("T", 9), np.float64, low=-2, high=2),
    "corner": Rule(("N", 3), np.int32, below="V"),
    "corner_weight": Rule(("N", 3), tests=(sums_to_one(1e-2),)),  # float16: three roundings by 2.4e-4 at most
}


def canonical_rotations(surface: Surface, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    """(M, 3, 3) float64 the linear part of what takes the points `rows` from the rest pose to the canonical one."""
    R = surface.A_canonical[:, :3, :3]
    return np.einsum("nk,nkab->nab", surface.joint_weight[rows], R[surface.joint_index[rows]], optimize=True)


@dataclasses.dataclass(frozen=True)
class Turns:
    """How the canonical pose turns a surface's points from the rest pose: rotations (M, 3, 3) float32 of the points
    `rows` (M,) that it turns at all, those below the hips."""

    rows: np.ndarray
    rotations: np.ndarray

    @classmethod
    def of(cls, surface: Surface) -> Turns:
        """Of all points of a surface; blended, so not rigid where two joints hold a point."""
        turned = np.abs(surface.A_canonical[:, :3, :3] - np.eye(3)).max((1, 2)) > 0
        rows = np.flatnonzero((turned[surface.joint_index] & (surface.joint_weight > 0)).any(1))
        return cls(rows, np.ascontiguousarray(canonical_rotations(surface, rows), np.float32))


@dataclasses.dataclass(frozen=True)
class PoseBlendshapes:
    """directions: (J - 1, 9, V, 3) float32, metres per entry of each joint's rotation matrix, root left out, at V
    vertices at rest. canonical: (J - 1, 9) those entries in the canonical pose. corner: (N, 3) int32 vertices about
    each point; corner_weight: (N, 3) float32, barycentric."""

    directions: np.ndarray
    canonical: np.ndarray
    corner: np.ndarray
    corner_weight: np.ndarray

    @classmethod
    def of(
        cls, posedirs: np.ndarray, canonical_pose: np.ndarray, corners: np.ndarray, weights: np.ndarray
    ) -> PoseBlendshapes:
        """From a body's posedirs (V, 3, 9 (J - 1)) and canonical pose (J, 3), of the vertices `corners` (N, 3) that
        points lie between."""
        used, corner = np.unique(corners, return_inverse=True)
        count = len(canonical_pose) - 1
        directions = np.moveaxis(posedirs[used], 2, 0).reshape(count, 9, len(used), 3)
        return cls(
            np.ascontiguousarray(directions, np.float32),
            matrix_from_axis_angle(np.asarray(canonical_pose[1:], np.float64)).reshape(count, 9),
            corner.reshape(-1, 3).astype(np.int32),
            np.ascontiguousarray(weights, np.float32),
        )

    def taken(self, chosen: np.ndarray | None) -> PoseBlendshapes:
        """Of the `chosen` points, None for all."""
        if chosen is None:
            return self
        rows = (np.ascontiguousarray(a[chosen]) for a in (self.corner, self.corner_weight))
        return PoseBlendshapes(self.directions, self.canonical, *rows)

    def offsets(self, pose: np.ndarray, turns: Turns) -> np.ndarray:
        """(N, 3) float32 metres in the canonical pose, for a pose (J, 3). turns: of the points' surface."""
        feature = matrix_from_axis_angle(pose[1:].astype(np.float64)).reshape(self.canonical.shape) - self.canonical
        moved = np.zeros(3 * self.directions.shape[2], np.float32)
        for j in np.flatnonzero(np.abs(feature).max(1) > STILL):  # a motion of 22 joints leaves the fingers alone
            moved += feature[j].astype(np.float32) @ self.directions[j].reshape(9, -1)
        vertices = moved.reshape(-1, 3)
        out = vertices.take(self.corner[:, 0], 0) * self.corner_weight[:, :1]
        for k in (1, 2):
            out += vertices.take(self.corner[:, k], 0) * self.corner_weight[:, k : k + 1]
        out[turns.rows] = np.matmul(turns.rotations, out[turns.rows][:, :, None])[:, :, 0]
        return out

    def to_arrays(self) -> dict[str, np.ndarray]:
        """For pose_blendshapes.npz: directions as float16, which rounds a millimetre by half a micrometre."""
        kind = np.uint16 if self.directions.shape[2] <= 1 << 16 else np.int32
        return {
            "directions": self.directions.astype(np.float16),
            "canonical": self.canonical,
            "corner": self.corner.astype(kind),
            "corner_weight": self.corner_weight.astype(np.float16),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], points: int, joints: int, source: str) -> PoseBlendshapes:
        """What `to_arrays` took apart; UserError naming `source` for what does not fit `points` and `joints`."""
        known = checked(arrays, RULES, source, sizes={"N": points, "T": joints - 1})
        weight = known["corner_weight"]
        return cls(**known | {"corner_weight": weight / weight.sum(1, keepdims=True)})


def read_pose_blendshapes(bundle: Bundle, points: int, joints: int) -> PoseBlendshapes | None:
    """Of all that a bundle holds, or None where the avatar was trained without them."""
    if MEMBER not in bundle.manifest.members:
        return None
    return PoseBlendshapes.from_arrays(bundle.arrays(MEMBER), points, joints, f"{bundle.path}: {MEMBER}")
