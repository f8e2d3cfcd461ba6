"""Facial expressions of an avatar: linear blendshapes of its surface points and of the joints that lie in the face
(SMPL-X, Pavlakos et al. 2019, equation 4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from ..bundle import Bundle
from ..errors import WrongValue
from ..values.array_rules import FAR, Rule, ascending, checked

MEMBER = "expression.npz"
NEGLIGIBLE = 1e-6  # metres a unit coefficient: points that no direction moves by more are left out
RULES = {  # of N points and J joints, M of the points move
    "rows": Rule(("M",), np.int32, below="N", empty=True, tests=(ascending,)),
    "directions": Rule(("M", 3, "E"), low=-FAR, high=FAR, empty=True),
    "joints": Rule(("J", 3, "E"), low=-FAR, high=FAR),
}


@dataclasses.dataclass(frozen=True)
class Expression:
    """What E expression coefficients do to N points and J joints.

    rows: (M,) int32, ascending, the points that move at all. directions: (M, 3, E) metres a unit coefficient, in the
    canonical pose. joints: (J, 3, E) the same of the joints at rest.
    """

    rows: np.ndarray
    directions: np.ndarray
    joints: np.ndarray

    @property
    def count(self) -> int:
        """E."""
        return self.directions.shape[2]

    @classmethod
    def of(cls, directions: np.ndarray, joints: np.ndarray) -> Expression:
        """From (N, 3, E) directions of all points."""
        rows = np.flatnonzero(np.abs(directions).max((1, 2), initial=0) > NEGLIGIBLE).astype(np.int32)
        return cls(rows, np.ascontiguousarray(directions[rows], np.float32), np.asarray(joints, np.float32))

    def taken(self, chosen: np.ndarray | None, count: int) -> Expression:
        """Of the `chosen` of `count` points (ascending rows), None for all."""
        if chosen is None:
            return self
        place = np.full(count, -1, np.int64)
        place[chosen] = np.arange(len(chosen))
        kept = place[self.rows] >= 0
        return Expression(place[self.rows[kept]].astype(np.int32), self.directions[kept], self.joints)

    def points(self, points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """A moved copy of points (N, 3)."""
        moved = points.copy()
        by_unit = self.directions.reshape(-1, self.count)  # one product: einsum takes ten times as long
        moved[self.rows] += (by_unit @ coefficients.astype(by_unit.dtype)).reshape(-1, 3)
        return moved

    def filled(self, coefficients: np.ndarray) -> np.ndarray:
        """(E,) float32 of that many coefficients or fewer, zero where none are given. Raises WrongValue for more of
        them, and for NaN or infinite ones."""
        if coefficients.ndim != 1 or len(coefficients) > self.count:
            raise WrongValue(
                f"expression has shape {coefficients.shape}, this avatar has {self.count} coefficients or fewer"
            )
        if not np.isfinite(coefficients).all():
            raise WrongValue("the expression is NaN or infinite")
        return np.pad(coefficients, (0, self.count - len(coefficients)))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """For expression.npz; float16 rounds a direction of 4 cm by at most 0.02 mm."""
        return {"rows": self.rows, "directions": self.directions.astype(np.float16), "joints": self.joints}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], points: int, joints: int, source: str) -> Expression:
        """What `to_arrays` took apart; UserError naming `source` for what does not fit `points` and `joints`."""
        return cls(**checked(arrays, RULES, source, sizes={"N": points, "J": joints}))


def read_expression(bundle: Bundle, points: int, joints: int) -> Expression | None:
    """Of all that a bundle holds, or None where its body has no face."""
    if MEMBER not in bundle.manifest.members:
        return None
    return Expression.from_arrays(bundle.arrays(MEMBER), points, joints, f"{bundle.path}: {MEMBER}")
