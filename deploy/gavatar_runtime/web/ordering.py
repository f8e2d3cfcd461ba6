"""The order in which points are stored, so that the first of them are an even sampling of all."""

from __future__ import annotations

import numpy as np

BITS = 16  # of a coordinate along the curve: 0.03 mm in a body of two metres


def progressive_order(points: np.ndarray) -> np.ndarray:
    """(N,) a permutation of points (N, 3), any prefix of which is spread over them all as evenly as they are.

    Points are strung along a Morton curve, which keeps neighbours together, and taken at the places of a van der Corput
    sequence: half way, at the quarters, at the eighths... The same points have the same order.
    """
    count = len(points)
    if count < 2:
        return np.arange(count)
    curve = np.argsort(morton_codes(points), kind="stable")
    bits = int(count - 1).bit_length()
    places = _reversed_bits(np.arange(1 << bits, dtype=np.int64), bits)
    return curve[places[places < count]]


def morton_codes(points: np.ndarray) -> np.ndarray:
    """(N,) uint64 places on the Morton curve through the bounding cube of points (N, 3), which are finite."""
    points = np.asarray(points, np.float64)
    low = points.min(0)
    side = max(float((points.max(0) - low).max()), np.finfo(np.float64).tiny)
    cells = np.minimum((points - low) / side * (1 << BITS), (1 << BITS) - 1).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(BITS):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return code


def _reversed_bits(values: np.ndarray, bits: int) -> np.ndarray:
    out = np.zeros_like(values)
    for bit in range(bits):
        out |= ((values >> bit) & 1) << (bits - 1 - bit)
    return out
