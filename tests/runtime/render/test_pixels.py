"""Colours as bytes."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.render.pixels import to_bytes


def test_bytes_are_rounded_and_clipped():
    color = np.array([[[0, 0.5, 1]], [[-1, 2, np.nan]], [[0.499 / 255, 0.501 / 255, np.inf]]])
    assert to_bytes(color).tolist() == [[[0, 128, 255]], [[0, 255, 0]], [[0, 1, 255]]]
