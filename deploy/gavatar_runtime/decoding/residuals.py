"""Attributes of Gaussians as a base and a residual of the pose: compiled where the kernel is, NumPy otherwise.

A base and a residual hold eight floats a Gaussian: x y z (canonical, metres), r g b, scale (metres), 0. Colours are
clipped to [0, 1] and scales to 0 after the sum. The results go into `out`: points (N, 3), colors (N, 3), scales (N,).
"""

from __future__ import annotations

import numpy as np

from .. import native_library as nl

Attributes = tuple[np.ndarray, np.ndarray, np.ndarray]


def empty(count: int) -> Attributes:
    """Room for points, colors and scales of `count` Gaussians, float32."""
    return np.empty((count, 3), np.float32), np.empty((count, 3), np.float32), np.empty(count, np.float32)


def packed(points: np.ndarray, colors: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """(N, 8) float32 of attributes."""
    return np.concatenate([points, colors, scales[:, None], np.zeros_like(scales)[:, None]], 1).astype(np.float32)


def grouped(basis: np.ndarray) -> np.ndarray:
    """Bases (N, K, 8) as (N, ceil(K / 4), 8, 4): for each channel four side by side, zero where there is none."""
    count, rank = basis.shape[:2]
    filled = np.zeros((count, -(-rank // 4) * 4, 8), basis.dtype)
    filled[:, :rank] = basis
    return np.ascontiguousarray(filled.reshape(count, filled.shape[1] // 4, 4, 8).swapaxes(2, 3))


def blendshapes(
    base: np.ndarray, part: np.ndarray, basis: np.ndarray, coefficients: np.ndarray, gains: np.ndarray, out: Attributes
) -> Attributes:
    """base + gains[part] * sum_k coefficients[part, k] basis[n, k].

    part: (N,) uint8, the body part of each Gaussian. basis: (N, K / 4, 8, 4) int8 as `grouped` gives it.
    coefficients: (P, K); gains: (P, 8), what a step of the basis is worth. All arrays contiguous.
    Raises IndexError for a part that `coefficients` does not have.
    """
    coefficients, gains = np.ascontiguousarray(coefficients, np.float32), np.ascontiguousarray(gains, np.float32)
    if not nl.available()[0]:
        return blendshapes_reference(base, part, basis, coefficients, gains, out)
    count, groups = basis.shape[:2]
    _check(
        base.shape == (count, 8) and part.shape == (count,) and coefficients.shape == (len(gains), 4 * groups), "shapes"
    )
    _check(basis.shape[2:] == (8, 4), "shapes")
    _check((base.dtype, part.dtype, basis.dtype) == (np.float32, np.uint8, np.int8), "dtypes")
    _check_layout(count, (base, part, basis), out)
    arrays = (x.ctypes.data for x in (base, part, basis, coefficients, gains, *out))
    _done(nl.library().gv_blendshapes(count, groups, len(gains), *arrays), "part", len(gains))
    return out


def upsample(base: np.ndarray, index: np.ndarray, weight: np.ndarray, table: np.ndarray, out: Attributes) -> Attributes:
    """base + sum_k weight[n, k] table[index[n, k]]. index: (N, K) int32; weight: (N, K) float32; table: (M, 8) float32.

    Raises IndexError for an index that `table` does not have.
    """
    if not nl.available()[0]:
        return upsample_reference(base, index, weight, table, out)
    _check(base.shape == (len(index), 8) and weight.shape == index.shape and table.shape[1] == 8, "shapes")
    dtypes = (base.dtype, index.dtype, weight.dtype, table.dtype)
    _check(dtypes == (np.float32, np.int32, np.float32, np.float32), "dtypes")
    table = np.ascontiguousarray(table)  # a name that outlives the call
    _check_layout(len(base), (base, index, weight), out)
    arrays = (x.ctypes.data for x in (base, index, weight, table, *out))
    _done(nl.library().gv_upsample(*index.shape, len(table), *arrays), "index", len(table))
    return out


def blendshapes_reference(
    base: np.ndarray, part: np.ndarray, basis: np.ndarray, coefficients: np.ndarray, gains: np.ndarray, out: Attributes
) -> Attributes:
    """`blendshapes` in NumPy."""
    if len(part) and part.max() >= len(coefficients):
        raise IndexError(f"residuals: part has entries outside 0..{len(coefficients) - 1}")
    residual = (
        np.einsum("ngcj,ngj->nc", basis.astype(np.float32), coefficients[part].reshape(len(part), basis.shape[1], 4))
        * gains[part]
    )
    return _unpacked(base + residual, out)


def upsample_reference(
    base: np.ndarray, index: np.ndarray, weight: np.ndarray, table: np.ndarray, out: Attributes
) -> Attributes:
    """`upsample` in NumPy."""
    if index.size and not 0 <= index.min() <= index.max() < len(table):
        raise IndexError(f"residuals: index has entries outside 0..{len(table) - 1}")
    return _unpacked(base + np.einsum("nkc,nk->nc", table[index], weight), out)


def _unpacked(values: np.ndarray, out: Attributes) -> Attributes:
    points, colors, scales = out
    points[...] = values[:, :3]
    np.clip(values[:, 3:6], 0, 1, out=colors)
    np.maximum(values[:, 6], 0, out=scales)
    return out


def _check(sound: bool, what: str) -> None:
    if not sound:
        raise ValueError(f"residuals: the arrays' {what} do not belong together")


def _check_layout(count: int, arrays: tuple[np.ndarray, ...], out: Attributes) -> None:
    """The kernel reads and writes by bare pointers: every array contiguous, and `out` float32 of `count` rows."""
    _check(all(a.flags.c_contiguous for a in (*arrays, *out)), "layout")
    _check([a.shape for a in out] == [(count, 3), (count, 3), (count,)], "shapes")
    _check(all(a.dtype == np.float32 for a in out), "dtypes")


def _done(code: int, name: str, limit: int) -> None:
    if code == -2:
        raise IndexError(f"residuals: {name} has entries outside 0..{limit - 1}")
    nl.check(code)
