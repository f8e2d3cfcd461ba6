"""What the footage of an avatar says of each of its points."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from .array_rules import Rule, checked

MEMBER = "evidence.npz"  # of a bundle; bundles of earlier versions have none
FULL = 2.0  # squarely seen views' worth from which on a point is what was seen of it, and nothing else

EVIDENCE_RULES = {
    "pixels": Rule(("N",), low=0, high=1e12),
    "views": Rule(("N",), low=0, high=1e9),
    "squareness": Rule(("N",), low=0, high=1),
    "poses": Rule(("N",), np.int32, low=0),
    "directions": Rule(("N",), np.int32, low=0),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """How often, how squarely, in how many poses and from how many sides training saw each of N points.

    pixels: (N,) float32, pixels of the training images that a point made up, each counted by how squarely it was seen:
    not at all below a cosine of 0.15 between normal and view, in full from 0.5 on; of a point that faces away a tenth,
    where it is seen past all else. views: (N,) float32, the same in units of the point's own area: how many views'
    worth, and not less than half of what is usual about it, for a point may lie under its neighbours. squareness: (N,)
    float32, mean of that cosine over all its pixels, 0 to 1. poses: (N,) int32, different poses of the joints about it
    that it was seen in. directions: (N,) int32, different directions, some 30 degrees apart and as it faces, that it
    was seen from.
    """

    pixels: np.ndarray
    views: np.ndarray
    squareness: np.ndarray
    poses: np.ndarray
    directions: np.ndarray

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def confidence(self) -> np.ndarray:
        """(N,) float32: 0 where nothing was seen, 1 where enough was, a smooth step between them."""
        share = np.clip(self.views / FULL, 0, 1)
        return (share * share * (3 - 2 * share)).astype(np.float32)

    def take(self, rows: np.ndarray) -> Evidence:
        """That of the points `rows` (M,), in that order."""
        return Evidence(**{name: array[rows] for name, array in self.to_arrays().items()})

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Named arrays, fit for `np.savez` and for `from_arrays`."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], source: str, count: int | None = None) -> Evidence:
        """What `to_arrays` took apart. count: of the points, where it is known. Raises UserError naming `source` for
        an array that is missing or breaks its rule (`EVIDENCE_RULES`)."""
        return cls(**checked(arrays, EVIDENCE_RULES, source, sizes=None if count is None else {"N": count}))
