"""Pictures of the capture that comes with gavatar, and the person in them."""

from __future__ import annotations

import cv2
import numpy as np
from places import DEMO


def picture(t: int) -> np.ndarray:
    """Frame t, (H, W, 3) uint8 BGR."""
    image = cv2.imread(str(DEMO / f"images/cam0/{t:06d}.jpg"))
    assert image is not None
    return image


def true_mask(t: int) -> np.ndarray:
    """(H, W) whether a pixel shows the person."""
    return cv2.imread(str(DEMO / f"masks/cam0/{t:06d}.png"), cv2.IMREAD_GRAYSCALE) > 127
