"""The progressive order of points, in which the first of them, however many, are an even sampling of all."""

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


def progressive_rank(points: np.ndarray) -> np.ndarray:
    """(N,) int32 the place of each of points (N, 3) in their `progressive_order`."""
    return ranks(progressive_order(points))


def ranks(order: np.ndarray) -> np.ndarray:
    """(N,) int32 the place of each thing in an order (N,), a permutation: its inverse."""
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    return rank


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
