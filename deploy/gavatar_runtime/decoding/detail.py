"""Level of detail: fewer Gaussians of the same surface, the first of its progressive order, each larger, so that the
surface stays closed."""

from __future__ import annotations

import numpy as np

from ..errors import WrongValue
from ..values.surface import Atlas, Surface

# of the spacing. By PSNR to the whole avatar 0.3 is best (an even patch deviates by 0.29 of its side), but cracks show:
# of the person's inside 71 to 86 % is closed at a half to a quarter of the points, and 92 to 95 % at 0.4, 2 dB below
SPREAD = 0.4
WORTH = 0.8  # of the Gaussians: leaving fewer of them out than the rest saves next to nothing
FEWEST = 1000  # that a program chooses by itself: of a person of 30 pixels
SHARE = 0.63  # of an atlas's texels that lie on the body, where no map tells: that of the free body


def first(surface: Surface, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Which of a surface's Gaussians stand for it at `count` of them, (M,) ascending, and the variance that each gains,
    (M,) square metres (`grown`): the first of its progressive order, all where it has no more.

    Raises WrongValue for fewer than one.
    """
    if count < 1:
        raise WrongValue(f"`gaussians={count}`: give a whole number from 1 up")
    chosen = np.flatnonzero(surface.rank < count)
    return chosen, added_variance(surface.spacing[chosen], len(surface) / len(chosen))


def added_variance(spacing: np.ndarray, fewer: float) -> np.ndarray:
    """(M,) square metres that Gaussians gain which stand for `fewer` times as many, from the spacing (M,) of all."""
    return np.float32(SPREAD**2 * (fewer - 1)) * np.square(spacing, dtype=np.float32)


def grown(scales: np.ndarray, added: np.ndarray) -> np.ndarray:
    """Scales (N,) with their variances enlarged: a Gaussian that speaks for a larger patch is its old self smoothed by
    the patch. Multiplying instead would swell what was already large and lose 10 dB."""
    return np.sqrt(np.square(scales) + added)


def count_for_size(surface: Surface, pixels: float) -> int:
    """A number of Gaussians that is enough for a person `pixels` tall: one for each pixel of the square about them, of
    which the body covers a third, seen from in front and from behind."""
    most = len(surface)
    return most if pixels**2 >= most else max(min(FEWEST, most), round(pixels**2))


def count_for_footage(surface: Surface, pixel: float | None) -> int:
    """A number of Gaussians that is enough for what the footage showed. pixel: metres of the person that a pixel of it
    spanned, None where that is not known, for which all are."""
    height = float(np.ptp(surface.points[:, 1]))
    return len(surface) if not pixel else count_for_size(surface, height / pixel)


def count_for_side(surface: Surface, atlas: Atlas | None, side: int) -> int:
    """The number of Gaussians that a level of detail stands for that is given as the side of an atlas, as it was before
    points were in any number. atlas: any of the same body, None where there is none."""
    known = surface if isinstance(surface, Atlas) else atlas
    share = SHARE if known is None else len(known) / known.resolution**2
    return int(np.clip(round(share * side**2), 1, len(surface)))
