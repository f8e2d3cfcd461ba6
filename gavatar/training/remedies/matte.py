"""The border of a mask, found anew where the footage tells it."""

from __future__ import annotations

import cv2
import numpy as np

LEAST_CONTRAST = 0.15  # distance of the colours of person and background below which they tell nothing
OVERLAP = 2.0  # pixels inside the border of a mask too narrow that are found anew as well


def matted(image: np.ndarray, mask: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) premultiplied colour and (H, W) alpha of an image whose mask is up to `width` pixels too wide, or,
    below zero, up to so many pixels too narrow.

    image: (H, W, 3) in [0, 1]. mask: (H, W) in [0, 1]. Within `width` pixels inside the border each pixel is taken for
    a mixture of the nearest colour deeper inside and the nearest one outside, `I = a F + (1 - a) B`, and alpha is the
    share by least squares; where the two colours are too alike the mask stays. Nothing outside the mask is added,
    unless it is too narrow: then the band lies outside its border, and a little inside.
    """
    wide = mask if width >= 0 else _grown(mask, -width)
    inside = wide > 0.5
    depth = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    person, behind = depth > (width if width >= 0 else OVERLAP - width), wide < 1 / 255
    if not person.any() or not behind.any():
        return image * mask[..., None], mask
    band = (wide > 0) & ~person
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)  # of noise; a pixel inside the border by its own width stays itself
    F, B = smooth[nearest(person)][band], smooth[nearest(behind)][band]
    apart = np.square(F - B).sum(-1)
    share = ((image[band] - B) * (F - B)).sum(-1) / np.maximum(apart, 1e-6)
    alpha = mask.copy()
    alpha[band] = np.where(apart > LEAST_CONTRAST**2, np.clip(share, 0, 1), mask[band])
    color = image * alpha[..., None]
    told = np.zeros_like(band)
    told[band] = apart > LEAST_CONTRAST**2
    color[told] = np.clip(image[told] - (1 - alpha[told][:, None]) * B[told[band]], 0, alpha[told][:, None])
    return color, alpha


def _grown(mask: np.ndarray, by: float) -> np.ndarray:
    """The mask with everything within `by` pixels of it."""
    outside = cv2.distanceTransform((mask <= 0.5).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.maximum(mask, (outside <= by).astype(mask.dtype)) if (mask > 0.5).any() else mask


def nearest(wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (H, W) of the nearest pixel of `wanted` (H, W) to each pixel."""
    _, label = cv2.distanceTransformWithLabels(
        (~wanted).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(wanted)
    place = np.zeros((label.max() + 1, 2), np.int64)
    place[label[rows, columns]] = np.stack([rows, columns], -1)
    return place[label, 0], place[label, 1]
