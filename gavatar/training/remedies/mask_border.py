"""How far the border of the masks lies from where the pictures themselves have one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from ...capture.capture import Capture, View
from .matte import LEAST_CONTRAST, nearest

VIEWS = 12  # looked at, spread evenly
REACH = 1 / 48  # of the person's longer side: how far from the mask's border the picture's own is looked for
LEAST_REACH, MOST_REACH = 6, 16  # pixels
OFF_LINE = 0.3  # of the two colours' distance that a mixture of them may lie beside the line between them
LEAST_TOLD, LEAST_PIXELS = 0.2, 40  # of the border where colours tell; of each pixel of depth

NEGLIGIBLE, NEGLIGIBLE_SHARE = 0.75, 0.002  # pixels, and share of the picture's side, that masks may be off by
SLACK = 2.0  # pixels on both sides of the border as measured within which it is found anew


@dataclasses.dataclass(frozen=True)
class MaskBorder:
    """pixels: by which masks are too wide, below zero too narrow. told: share of their border where the colours of
    person and background differ enough to tell. side: pixels of the picture's longer side."""

    pixels: float
    told: float
    side: int

    @property
    def mending(self) -> float:
        """The `mask_matte` that mends it, 0 where nothing is to be mended."""
        if abs(self.pixels) < max(NEGLIGIBLE, NEGLIGIBLE_SHARE * self.side):
            return 0.0
        return float(np.sign(self.pixels) * (round(abs(self.pixels)) + SLACK))


def mask_border(capture: Capture, views: Sequence[View]) -> MaskBorder | None:
    """Where the masks' border lies beside the picture's, over some of the views; None where colours do not tell.

    Along the border every pixel is taken for a mixture of the nearest colour well inside and the nearest well outside
    (`shares`). Where the median share, over all pixels of one depth below the masks' border, passes one half, there
    is the border of the person; single pixels are wrong by far, of hair, shadows and folds, but not their median.
    """
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, VIEWS).round().astype(int))]
    found, side = [], 0
    for view in chosen:
        image, mask = capture.read(view)
        side = max(side, *mask.shape)
        found.append(shares(image[..., ::-1].astype(np.float32) / 255, mask.astype(np.float32) / 255))
    depth, share, told = (np.concatenate(parts) for parts in zip(*found, strict=True))
    near = np.abs(depth) < LEAST_REACH - 2
    if not told[near].any() or told[near].mean() < LEAST_TOLD:
        return None
    pixels = _crossing(depth[told], share[told])
    return None if pixels is None else MaskBorder(round(pixels, 2), round(float(told[near].mean()), 3), side)


def shares(image: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the P pixels near a mask's border: (P,) depth in pixels inside it, below zero outside; (P,) share of the
    person in their colour; (P,) bool whether colours tell. image: (H, W, 3) in [0, 1]. mask: (H, W) in [0, 1]."""
    inside = (mask > 0.5).astype(np.uint8)
    left, top, width, height = cv2.boundingRect(inside)
    reach = int(np.clip(REACH * max(width, height), LEAST_REACH, MOST_REACH))
    rows, columns = (
        slice(max(0, at - 3 * reach), at + size + 3 * reach) for at, size in ((top, height), (left, width))
    )
    image, inside = image[rows, columns], inside[rows, columns]
    depth = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    depth = np.where(inside, depth - 0.5, 0.5 - cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    person, behind, band = depth > reach, depth < -reach, np.abs(depth) < reach
    if not person.any() or not behind.any():
        return np.zeros(0), np.zeros(0), np.zeros(0, bool)
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    F, B, mixed = smooth[nearest(person)][band], smooth[nearest(behind)][band], image[band]
    apart = np.square(F - B).sum(-1)
    share = np.clip(((mixed - B) * (F - B)).sum(-1) / np.maximum(apart, 1e-6), 0, 1)
    beside = np.square(mixed - B - share[:, None] * (F - B)).sum(-1)
    return depth[band], share, (apart > LEAST_CONTRAST**2) & (beside < OFF_LINE**2 * apart)


def _crossing(depth: np.ndarray, share: np.ndarray) -> float | None:
    """The depth at which the median share passes one half from outside in, None where it does not."""
    level = np.floor(depth).astype(int)
    if not len(level):
        return None
    levels = [k for k in range(level.min(), level.max() + 1) if (level == k).sum() >= LEAST_PIXELS]
    medians = [float(np.median(share[level == k])) for k in levels]
    for k in range(1, len(levels)):
        before, after = medians[k - 1], medians[k]
        if before < 0.5 <= after:
            return levels[k - 1] + 0.5 + (levels[k] - levels[k - 1]) * (0.5 - before) / (after - before)
    return None
