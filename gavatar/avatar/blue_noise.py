"""A progressive order of places on a surface: the first n of them are an even sampling of it, for every n."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from gavatar_runtime.values.surface import Surface

CANDIDATES = 7  # offered for each point that is wanted: twice as many take three times as long for little
SHRINK = 2**-0.25  # of the radius from one level to the next
# Radius that a level ends at with all points that fit, in units of the root of a point's share of the surface. The
# sparsest cover there is, a hexagonal grid, has 0.62.
COVER = 0.69
_LEAST = 0.7 * COVER  # what is nearer to a taken point will never be taken: the last level ends above
_NEAREST = 8  # taken points that a candidate is held against: those of another side of the body are among them


def progressive_order(places: np.ndarray, normals: np.ndarray, spacing: np.ndarray, count: int) -> np.ndarray:
    """(count,) int64 rows of M candidates; each prefix keeps its points as far apart as their number allows.

    places: (M, 3) metres, drawn at random from a surface with the density that is wanted, in random order. normals:
    (M, 3), unit. spacing: (M,) metres, the root of a point's share of the surface there, when it has `count` points.
    count: 1 to M, of which M / `CANDIDATES` give an even result.

    Dart throwing with a falling radius (McCool and Fiume, "Hierarchical Poisson disk sampling distributions", 1992):
    at each level the candidates that keep the radius, in units of their spacing, from all taken points are taken one
    after another, those in the widest gaps first. Points whose normals are more than a right angle apart do not see one
    another, for along the body they are far apart: an arm and the trunk, two fingers, the two sides of a hand.
    """
    if not 0 < count <= len(places):
        raise ValueError(f"{count} of {len(places)} candidates cannot be ordered")
    candidates = _Candidates(places, normals, spacing)
    gap = np.full(len(places), np.inf)  # to the nearest taken point, in spacings; exact where it matters
    undecided = np.ones(len(places), bool)
    order = np.zeros(0, np.int64)
    radius, offered = COVER * math.sqrt(count), 0
    while len(order) < count and radius > _LEAST:
        # few points are chosen among few candidates, else the first levels would weigh all against all
        more = min(len(places), math.ceil(CANDIDATES * count * (COVER / radius) ** 2) + _NEAREST)
        candidates.narrow(gap, np.arange(offered, more), order, radius)
        offered = more
        rows = np.flatnonzero(undecided[:offered])
        rows = rows[gap[rows] > radius]
        taken = candidates.independent(rows[np.argsort(-gap[rows], kind="stable")], radius)
        order = np.concatenate([order, taken])
        undecided[taken] = False
        candidates.narrow(gap, np.flatnonzero(undecided[:offered]), taken, radius)
        undecided &= gap > _LEAST
        radius *= SHRINK
    left = np.ones(len(places), bool)
    left[order] = False  # where candidates are fewer than an even result takes, any of them
    return np.concatenate([order, np.flatnonzero(left)])[:count]


class _Candidates:
    """Places on a surface, and how far apart they are in units of the spacing there."""

    def __init__(self, places: np.ndarray, normals: np.ndarray, spacing: np.ndarray):
        self.places, self.normals, self.spacing = places, normals, spacing

    def narrow(self, gap: np.ndarray, rows: np.ndarray, taken: np.ndarray, radius: float) -> None:
        """Lower `gap` of `rows` to the nearest of `taken`, where that is nearer than `radius` or little farther."""
        if not len(rows) or not len(taken):
            return
        count = min(_NEAREST, len(taken))
        reach = radius / SHRINK * max(self.spacing[rows].max(), self.spacing[taken].max())
        nearest = cKDTree(self.places[taken]).query(
            self.places[rows], k=np.arange(1, count + 1), distance_upper_bound=reach
        )[1]
        there = nearest < len(taken)
        others = taken[np.where(there, nearest, 0)]
        distance = self._distances(np.repeat(rows, count), others.reshape(-1)).reshape(others.shape)
        gap[rows] = np.minimum(gap[rows], np.where(there, distance, np.inf).min(1))

    def independent(self, rows: np.ndarray, radius: float) -> np.ndarray:
        """As many of `rows` as keep `radius` from one another, the first having precedence."""
        if not len(rows):
            return rows
        reach = radius * self.spacing[rows].max()
        pairs = cKDTree(self.places[rows]).query_pairs(reach, output_type="ndarray")
        first, second = pairs.min(1), pairs.max(1)
        near = self._distances(rows[first], rows[second]) < radius
        first, second = first[near], second[near]
        undecided, kept = np.ones(len(rows), bool), np.zeros(len(rows), bool)
        while undecided.any():  # all that nobody with precedence stands near, at once
            winners = undecided.copy()
            winners[second] = False
            kept |= winners
            undecided &= ~winners
            undecided[second[winners[first]]] = False
            both = undecided[first] & undecided[second]
            first, second = first[both], second[both]
        return rows[kept]

    def _distances(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(P,) distances of pairs in units of their mean spacing, infinite between sides of the body."""
        spacing = 0.5 * (self.spacing[one] + self.spacing[other])
        distance = np.linalg.norm(self.places[one] - self.places[other], axis=-1) / spacing
        facing = np.einsum("pc,pc->p", self.normals[one], self.normals[other]) > 0
        return np.where(facing, distance, np.inf)


def spread(surface: Surface) -> float:
    """By what share of its mean the distance to the nearest point on the same side of the body varies, in units of
    the spacing there: 0.52 of random places, 0 of a hexagonal grid."""
    distance, other = cKDTree(surface.points).query(surface.points, k=min(9, len(surface)))
    same = np.einsum("nkc,nc->nk", surface.normals[other], surface.normals) > 0
    same[:, 0] = False  # itself
    relative = np.where(same, 2 * distance / (surface.spacing[other] + surface.spacing[:, None]), np.inf).min(1)
    relative = relative[np.isfinite(relative)]
    return float(relative.std() / relative.mean())
