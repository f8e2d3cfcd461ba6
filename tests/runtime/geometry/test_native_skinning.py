"""The compiled kernel's skinning beside NumPy's and torch's."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from native_bench import built, relative

from gavatar.avatar.torch_skinning import dense_weights
from gavatar.avatar.torch_skinning import skin as torch_skin
from gavatar_runtime import native_library as nl
from gavatar_runtime.geometry import kinematics
from gavatar_runtime.geometry.skinning import skin, skin_gradients

pytestmark = [built, pytest.mark.usefixtures("kernel_defaults_afterwards")]


def skinning_problem(n: int, slots: int, rows: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    weight = rng.random((n, slots)).astype(np.float32)
    weight /= weight.sum(1, keepdims=True)
    A = rng.normal(size=(24, rows, 4)).astype(np.float32)
    points = rng.normal(size=(n, 3)).astype(np.float32)
    return points, rng.integers(0, 24, (n, slots)).astype(np.int32), weight, A


@pytest.mark.parametrize("n", [0, 1, 257, 20000])
@pytest.mark.parametrize("slots", [1, 4, 7])
@pytest.mark.parametrize("rows", [3, 4])
def test_skinning_agrees_with_numpy(n, slots, rows):
    points, index, weight, A = skinning_problem(n, slots, rows)
    expected = kinematics.skin(points.astype(np.float64), index, weight, A.astype(np.float64))
    np.testing.assert_allclose(skin(points, index, weight, A), expected, atol=1e-5)  # a dozen float32 terms of order 1
    out = np.empty((n, 3), np.float32)
    assert skin(points, index.astype(np.int64), weight.astype(np.float64), A, out=out) is out
    np.testing.assert_allclose(out, expected, atol=1e-5)


def test_skinning_keeps_float64():
    points, index, weight, A = skinning_problem(10, 4, 4)
    assert skin(points.astype(np.float64), index, weight, A.astype(np.float64)).dtype == np.float64


@pytest.mark.parametrize("bad", [-1, 24])
def test_skinning_refuses_a_joint_that_is_not_there(bad):
    points, index, weight, A = skinning_problem(9000, 4, 4)
    index[8765, 2] = bad
    with pytest.raises(IndexError, match=r"0\.\.23"):
        skin(points, index, weight, A)


@pytest.mark.parametrize("slots", [1, 4, 7])
def test_skinning_gradients_agree_with_torch(slots):
    points, index, weight, A = skinning_problem(9000, slots, 3)
    upstream = np.random.default_rng(1).normal(size=points.shape).astype(np.float32)
    p, T = (torch.tensor(x.astype(np.float64), requires_grad=True) for x in (points, A))
    dense = torch.as_tensor(dense_weights(index, weight.astype(np.float64), 24))
    torch_skin(p, dense, T).backward(torch.as_tensor(upstream, dtype=torch.float64))
    by_points, by_A = skin_gradients(points, index, weight, A, upstream)
    assert relative(by_points, p.grad.numpy()) < 1e-6  # single sums in float32
    assert relative(by_A, T.grad.numpy()) < 1e-5  # thousands of float32 terms a sum
    nl.set_threads(1)
    np.testing.assert_array_equal(skin_gradients(points, index, weight, A, upstream)[1], by_A)
