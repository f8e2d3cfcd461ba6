"""Level of detail: fewer Gaussians of the same surface, each larger, so that it stays closed."""

from __future__ import annotations

import numpy as np

from ..errors import WrongValue
from ..values.surface import Atlas

MIN_UV = 64
SPREAD = 0.35  # of the spacing: the deviation of an even patch is 0.29 of its side, and below 0.35 holes show at uv 128
WORTH = 0.9  # of the atlas's side: above, leaving Gaussians out saves less than a fifth of them
PIXELS_PER_GAUSSIAN = 0.8  # of the person's height to the atlas's side, below which a coarser one is enough


def thinned(surface: Atlas, uv: int) -> tuple[np.ndarray, np.ndarray]:
    """Which of a surface's Gaussians stand for it at side `uv` of the atlas, (M,) ascending, and the variance that each
    gains, (M,) square metres (`grown`): one Gaussian for each cell of the coarser atlas that holds any, the one nearest
    to its centre.

    Raises UserError for a side below 64 or above the surface's own.
    """
    R = surface.resolution
    if not MIN_UV <= uv <= R:
        fault = f"`uv={uv}`: this avatar has detail from {MIN_UV} to {R}"
        raise WrongValue(f"{fault}; export it with a larger --uv for more")
    place = (np.stack([surface.texel % R, surface.texel // R]) + 0.5) * (uv / R)
    cell = np.floor(place).astype(np.int64)
    off = np.square(place - cell - 0.5).sum(0)
    order = np.lexsort((np.arange(len(off)), off, cell[1] * uv + cell[0]))
    key = (cell[1] * uv + cell[0])[order]
    chosen = np.sort(order[np.concatenate([[True], key[1:] != key[:-1]])])
    added = SPREAD**2 * ((R / uv) ** 2 - 1) * np.square(point_spacing(surface)[chosen])
    return chosen, added.astype(np.float32)


def grown(scales: np.ndarray, added: np.ndarray) -> np.ndarray:
    """Scales (N,) with their variances enlarged: a Gaussian that speaks for a larger patch is its old self smoothed by
    the patch. Multiplying instead would swell what was already large and lose 10 dB."""
    return np.sqrt(np.square(scales) + added)


def point_spacing(surface: Atlas) -> np.ndarray:
    """(N,) metres from a point to its neighbours in the atlas, geometric mean of right and down; beside the rim of a
    chart, and where a neighbour is on another, the median of all."""
    R = surface.resolution
    at = np.full((R + 1) * (R + 1), -1, np.int64)
    row, column = np.divmod(surface.texel.astype(np.int64), R)
    at[row * (R + 1) + column] = np.arange(len(surface))
    steps = []
    for down, right in ((0, 1), (1, 0)):
        other = at[(row + down) * (R + 1) + column + right]
        distance = np.linalg.norm(surface.points[other] - surface.points, axis=1)
        known = distance[other >= 0]
        middle = float(np.median(known)) if len(known) else 0.0
        steps.append(np.where((other >= 0) & (distance < 4 * middle), distance, middle))
    return np.sqrt(steps[0] * steps[1])


def uv_for_size(surface: Atlas, pixels: float) -> int:
    """A side of the atlas that is enough for a person `pixels` tall: one Gaussian a pixel or so."""
    return int(np.clip(np.rint(pixels / PIXELS_PER_GAUSSIAN), MIN_UV, surface.resolution))


def uv_for_count(surface: Atlas, count: int) -> int:
    """The largest side of the atlas that keeps at most `count` of a surface's Gaussians. Raises WrongValue for fewer
    than the coarsest level keeps."""
    low, high = MIN_UV, surface.resolution
    if len(surface) <= count:
        return high
    fewest = len(thinned(surface, low)[0])
    if count < fewest:
        raise WrongValue(f"`gaussians={count}`: this avatar has {fewest} to {len(surface)}")
    while high - low > 1:  # `low` keeps few enough, `high` keeps more
        middle = (low + high) // 2
        low, high = (middle, high) if len(thinned(surface, middle)[0]) <= count else (low, middle)
    return low
