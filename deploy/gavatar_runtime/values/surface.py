"""Points of the body surface, free ones or the texels of a UV atlas, and what a pose does to them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from ..geometry.kinematics import invert_rigid, joint_transforms, moved_rest, skin, skinning_transforms
from ..geometry.ordering import progressive_rank, ranks
from .array_rules import FAR, Rule, a_permutation, a_tree, checked, rigid, sums_to_one

LARGEST = 1 << 14  # side of an atlas
# N points, J joints, K weights a point. What a bundle leaves out is NaN there, or -1.
SURFACE_RULES = {
    "uv": Rule(("N", 2)),
    "face": Rule(("N",), np.int32, low=-1),
    "barycentric": Rule(("N", 3), finite=False),
    "points": Rule(("N", 3), low=-FAR, high=FAR),
    "normals": Rule(("N", 3), finite=False),
    "parents": Rule(("J",), np.int32, low=-1, tests=(a_tree,)),
    "joints": Rule(("J", 3), np.float64, low=-FAR, high=FAR),
    "joint_index": Rule(("N", "K"), np.int32, below="J"),
    # float32 as they were sampled: what rounding leaves is a hundredth of this
    "joint_weight": Rule(("N", "K"), low=0, tests=(sums_to_one(1e-3),)),
    "spacing": Rule(("N",), finite=False),
    "rank": Rule(("N",), np.int32, below="N", optional=True, tests=(a_permutation,)),  # none before there was an order
    "A_canonical": Rule(("J", 4, 4), np.float64, low=-FAR, high=FAR, tests=(rigid,)),
    "weight_truncation": Rule((), np.float64),
}
ATLAS_RULES = {  # of side R
    "resolution": Rule((), np.int64, low=1, high=LARGEST, size="R"),
    "texel": Rule(("N",), np.int32, below="R R"),
    **SURFACE_RULES,
}
_OF_POINTS = ("uv", "face", "barycentric", "points", "normals", "joint_index", "joint_weight", "spacing")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Surface:
    """N points on a body of J joints in its canonical pose, in any number and at any places.

    They are stored so that points near in memory are near on the body, which drawing is a third faster for. `rank`
    gives them a second order, in which the first n, however many, are spread over the body as all of them are: a level
    of detail is such a `prefix`.

    uv: (N, 2) float32 places in the body's atlas as (u, 1 - v), v DOWN, so that
    `grid_sample(image, 2 * uv - 1, align_corners=False)` reads an image over the atlas. face: (N,) int32. barycentric:
    (N, 3) float32, weights of the face's corners. points: (N, 3) float32, metres, canonical pose. normals: (N, 3)
    float32, unit, canonical pose. joint_index: (N, K) int32 and joint_weight: (N, K) float32, skinning weights that sum
    to 1, in descending order; unused entries have index 0 and weight 0. spacing: (N,) float32, metres, the square root
    of the area that a point stands for. rank: (N,) int32, a permutation, each point's place in the progressive order.
    joints: (J, 3) float64 rest joints, metres. parents: (J,) int32, -1 for the root. A_canonical: (J, 4, 4) float64
    rest-to-canonical skinning transforms. weight_truncation: the largest sum of skinning weights that any point lost to
    the limit on K.
    """

    uv: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    joint_index: np.ndarray
    joint_weight: np.ndarray
    spacing: np.ndarray
    rank: np.ndarray
    joints: np.ndarray
    parents: np.ndarray
    A_canonical: np.ndarray
    weight_truncation: float = 0.0

    def __len__(self) -> int:
        return len(self.points)

    @property
    def num_joints(self) -> int:
        return len(self.parents)

    @property
    def root(self) -> int:
        """Index of the root joint."""
        return int(np.flatnonzero(self.parents < 0)[0])

    def skin_transforms(self, poses: np.ndarray, shift: np.ndarray | None = None) -> np.ndarray:
        """(..., J, 4, 4) canonical-to-posed transforms of the joints, A_live A_canonical^-1, without translation.

        poses: (..., J, 3) axis-angle relative to the parent, radians. shift: (J, 3) metres that the rest joints are
        moved by (an expression moves those of the face), or None. The result has the dtype of `poses`; it is computed
        in float64. Raises ValueError when the joints are not J.
        """
        poses = np.asarray(poses)
        _check_poses(poses, self.num_joints)
        dtype = poses.dtype if np.issubdtype(poses.dtype, np.floating) else np.dtype(np.float32)
        joints, A_canonical = self.joints, self.A_canonical
        if shift is not None:
            joints = joints + shift
            A_canonical = moved_rest(A_canonical, joints, self.parents)
        T = joint_transforms(poses.astype(np.float64), joints, self.parents)
        return (skinning_transforms(T, joints) @ invert_rigid(A_canonical)).astype(dtype)

    def posed(self, poses: np.ndarray) -> np.ndarray:
        """(N, 3) float32 points of the surface in one pose (J, 3), metres, without translation."""
        A = self.skin_transforms(np.asarray(poses, np.float32))
        return skin(self.points, self.joint_index, self.joint_weight, A)

    def take(self, rows: np.ndarray) -> Self:
        """The surface with only the points `rows` (M,), in that order; their progressive order stays what it was."""
        rank = ranks(np.argsort(self.rank[rows], kind="stable"))
        return dataclasses.replace(self, rank=rank, **{name: getattr(self, name)[rows] for name in self._of_points()})

    def prefix(self, count: int) -> Self:
        """The first `count` points of the progressive order, stored as they were, each standing for the more: a surface
        at a lower level of detail, itself where it has no more. Raises ValueError for fewer than one."""
        if count < 1:
            raise ValueError(f"a surface of {count} points is none")
        if count >= len(self):
            return self
        first = self.take(np.flatnonzero(self.rank < count))
        return dataclasses.replace(first, spacing=first.spacing * np.float32(np.sqrt(len(self) / count)))

    @classmethod
    def _of_points(cls) -> tuple[str, ...]:
        """Names of the fields with a row a point, but for `rank`."""
        return _OF_POINTS

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The surface as named arrays, none of them objects: fit for `np.savez` and for `from_arrays`."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in dataclasses.fields(self)}

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray], source: str = "surface") -> Surface:
        """The surface that `to_arrays` took apart, an `Atlas` if it was one; `source` names the file in messages.

        An order is made up for points without one (`progressive_order`). Raises UserError for an array that is missing
        or breaks its rule (`SURFACE_RULES`, `ATLAS_RULES`).
        """
        atlas = "texel" in arrays or "resolution" in arrays
        values: dict[str, Any] = checked(arrays, ATLAS_RULES if atlas else SURFACE_RULES, source)
        values["weight_truncation"] = float(values["weight_truncation"])
        if "rank" not in values:
            values["rank"] = progressive_rank(values["points"])
        if not atlas:
            return Surface(**values)
        return Atlas(**values | {"resolution": int(values["resolution"])})


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Atlas(Surface):
    """The surface as a regular grid: one point for each valid texel of an R x R UV atlas.

    Row 0 of the atlas is the top, v = 1: the texel of row i and column j has its centre at u = (j + 0.5) / R,
    v = 1 - (i + 0.5) / R, and that is its point's `uv`. A texel whose centre lies beside the atlas's charts but whose
    square touches one stands for the nearest point of that chart: there alone, `face` and `barycentric` are not exactly
    at `uv`.

    resolution: R. texel: (N,) int32, i * R + j.
    """

    resolution: int
    texel: np.ndarray

    @classmethod
    def _of_points(cls) -> tuple[str, ...]:
        return (*_OF_POINTS, "texel")


def _check_poses(poses: np.ndarray, num_joints: int) -> None:
    if poses.shape[-2:] != (num_joints, 3):
        raise ValueError(f"poses have shape {poses.shape}, expected (..., {num_joints}, 3)")
