"""Colours of a person without the room behind them."""

from __future__ import annotations

import cv2
import numpy as np

LEAST_LIGHT, MOST_LIGHT = 0.5, 1.15  # of the room's, in shadows and in other exposures


def without_background(image: np.ndarray, alpha: np.ndarray, room: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32 premultiplied colour `alpha F = I - (1 - alpha) B`, within what alpha allows.

    image, room: (H, W, 3) float32 in [0, 1], the room without the person. alpha: (H, W) in [0, 1]. The room's light is
    taken as it is beside each place, for a person throws shadows.
    """
    color = image * alpha[..., None]
    rim = (alpha > 0) & (alpha < 1)
    x, y, w, h = cv2.boundingRect(rim.astype(np.uint8))
    if w == 0:
        return color
    reach = max(2, round(0.02 * max(w, h)))
    part = slice(max(0, y - reach), y + h + reach), slice(max(0, x - reach), x + w + reach)
    I, B, a = image[part], room[part], alpha[part]
    outside, side = (a == 0).astype(np.float32), (2 * reach + 1, 2 * reach + 1)
    seen, empty = (cv2.blur(picture.mean(2) * outside, side) for picture in (I, B))
    light = np.clip((seen + 1e-3) / (empty + 1e-3), LEAST_LIGHT, MOST_LIGHT)[..., None]
    pure = np.clip(I - (1 - a[..., None]) * light * B, 0, a[..., None])
    color[part] = np.where(rim[part][..., None], pure, color[part])
    return color
