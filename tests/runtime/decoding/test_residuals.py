"""Residuals of a pose added to the still look: the compiled kernels against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime import native_library
from gavatar_runtime.decoding import residuals

needs_kernel = pytest.mark.skipif(not native_library.available()[0], reason=native_library.available()[1])


def random_residuals(count: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    base = rng.normal(0.4, 0.5, (count, 8)).astype(np.float32)
    part = rng.integers(0, 5, count).astype(np.uint8)
    basis = rng.integers(-127, 128, (count, 6, 8)).astype(np.int8)
    coefficients = rng.normal(0, 1, (5, 6)).astype(np.float32)
    gains = rng.uniform(0, 1e-3, (5, 8)).astype(np.float32)
    return base, part, residuals.grouped(basis), np.pad(coefficients, ((0, 0), (0, 2))), gains


@needs_kernel
@pytest.mark.parametrize("count", [0, 1, 8191, 20001])
def test_compiled_residuals_are_those_of_numpy(count):
    values = random_residuals(count)
    got = residuals.blendshapes(*values, residuals.empty(count))
    expected = residuals.blendshapes_reference(*values, residuals.empty(count))
    rng = np.random.default_rng(1)
    index = rng.integers(0, 50, (count, 4)).astype(np.int32)
    weight, table = rng.random((count, 4), np.float32), rng.normal(0, 1, (50, 8)).astype(np.float32)
    got += residuals.upsample(values[0], index, weight, table, residuals.empty(count))
    expected += residuals.upsample_reference(values[0], index, weight, table, residuals.empty(count))
    for a, b in zip(got, expected, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-6)  # sums of a few float32 numbers near 1, in another order


@needs_kernel
def test_residuals_refuse_a_part_or_row_that_is_not_there():
    base, part, basis, coefficients, gains = random_residuals(10)
    part[7] = 5
    for function in (residuals.blendshapes, residuals.blendshapes_reference):
        with pytest.raises(IndexError, match="part"):
            function(base, part, basis, coefficients, gains, residuals.empty(10))
    index = np.full((10, 2), 3, np.int32)
    for function in (residuals.upsample, residuals.upsample_reference):
        with pytest.raises(IndexError, match="index"):
            function(base, index, np.ones((10, 2), np.float32), np.ones((3, 8), np.float32), residuals.empty(10))


def test_grouped_bases_mean_what_they_say():
    rng = np.random.default_rng(0)
    basis = rng.integers(-127, 128, (3, 6, 8)).astype(np.int8)
    w = rng.normal(size=6).astype(np.float32)
    base, part, gains = np.zeros((3, 8), np.float32), np.zeros(3, np.uint8), np.full((1, 8), 1e-3, np.float32)
    padded = np.pad(w, (0, 2))[None]
    points = residuals.blendshapes(base, part, residuals.grouped(basis), padded, gains, residuals.empty(3))[0]
    expected = 1e-3 * np.einsum("nkc,k->nc", basis.astype(np.float32), w)[:, :3]
    np.testing.assert_allclose(points, expected, atol=1e-6)
