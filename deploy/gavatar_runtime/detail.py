"""Level of detail: fewer Gaussians of the same surface, each larger, so that it stays closed."""

from __future__ import annotations

import numpy as np

from .errors import UserError
from .surface import Surface

MIN_UV = 64
PIXELS_PER_GAUSSIAN = (
    0.8  # of the person's height in the image to the atlas's side, below which a coarser one is enough
)


def thinned(surface: Surface, uv: int) -> tuple[np.ndarray, float]:
    """Which of a surface's Gaussians stand for it at side `uv` of the atlas, (M,) ascending, and by what their scales
    grow: one Gaussian for each cell of the coarser atlas that holds any, the one nearest to its centre.

    Raises UserError for a side below 64 or above the surface's own.
    """
    R = surface.resolution
    if not MIN_UV <= uv <= R:
        raise UserError(f"uv={uv}: this avatar has detail from {MIN_UV} to {R}; export it with a larger --uv for more")
    place = (np.stack([surface.texel % R, surface.texel // R]) + 0.5) * (uv / R)
    cell = np.floor(place).astype(np.int64)
    off = np.square(place - cell - 0.5).sum(0)
    order = np.lexsort((np.arange(len(off)), off, cell[1] * uv + cell[0]))
    key = (cell[1] * uv + cell[0])[order]
    return np.sort(order[np.concatenate([[True], key[1:] != key[:-1]])]), R / uv


def uv_for_size(surface: Surface, pixels: float) -> int:
    """A side of the atlas that is enough for a person `pixels` tall: one Gaussian a pixel or so."""
    return int(np.clip(round(pixels / PIXELS_PER_GAUSSIAN), MIN_UV, surface.resolution))
