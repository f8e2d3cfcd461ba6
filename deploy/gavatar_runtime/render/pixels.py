"""Pixels as image files hold them."""

from __future__ import annotations

import numpy as np


def to_bytes(color: np.ndarray) -> np.ndarray:
    """(H, W, 3) in [0, 1] -> uint8, rounded; values outside are clipped, NaN is black."""
    return np.rint(np.clip(np.nan_to_num(color), 0, 1) * 255).astype(np.uint8)
