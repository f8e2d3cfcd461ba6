"""Evenly spaced picks of frames, views and rows."""

from __future__ import annotations

import numpy as np


def evenly_spaced(total: int, count: int) -> np.ndarray:
    """At most `count` indices of `total` things, ascending, the first and the last among them; the first if count is 1,
    all if they are fewer, none of none."""
    return np.linspace(0, total - 1, min(count, total)).astype(int) if total > 0 else np.zeros(0, int)
