"""Rotations in NumPy and torch: the same, and right at zero, at pi and beyond."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import gavatar_runtime.geometry.rotations as np_rot
from gavatar.body.torch_rotations import matrix_from_axis_angle
from gavatar_runtime.geometry.spacing import evenly_spaced

AXES = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [0.6, 0.0, -0.8], [0.57735, 0.57735, 0.57735]])
ANGLES = [
    0.0,
    1e-30,
    1e-12,
    1e-8,
    1e-5,
    0.0099,
    0.0101,
    0.5,
    3.0,
    np.pi - 1e-9,
    np.pi,
    np.pi + 1e-9,
    4.0,
    2 * np.pi,
    7.0,
]


def samples(dtype=np.float64) -> np.ndarray:
    random = np.random.default_rng(0).normal(size=(50, 3)) * 2
    return np.concatenate([(a * AXES) for a in ANGLES] + [random]).astype(dtype)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-14), (np.float32, 2e-6)])
def test_axis_angle_to_matrix_agrees_with_scipy_in_both_halves(dtype, tolerance):
    # tolerance: a dozen roundings of the dtype; AXES hold five digits, so scipy gets the very same vectors
    vectors = samples(dtype)
    expected = Rotation.from_rotvec(vectors.astype(np.float64)).as_matrix()
    assert np.abs(np_rot.matrix_from_axis_angle(vectors) - expected).max() < tolerance * 4
    assert np.abs(matrix_from_axis_angle(torch.from_numpy(vectors)).numpy() - expected).max() < tolerance * 4


def test_matrix_to_axis_angle_and_back_is_the_same_rotation():
    matrices = np_rot.matrix_from_axis_angle(samples())
    vectors = np_rot.axis_angle_from_matrix(matrices)
    assert np.linalg.norm(vectors, axis=-1).max() <= np.pi + 1e-12
    # near pi the axis comes from square roots of differences: half of the digits of float64
    assert np.abs(np_rot.matrix_from_axis_angle(vectors) - matrices).max() < 1e-7


def test_quaternions_of_tiny_and_zero_rotations_stay_finite():
    for dtype in (np.float16, np.float32, np.float64):
        zero = np.zeros((1, 3), dtype)
        q = np_rot.quaternion_from_axis_angle(zero)
        assert q.dtype == dtype
        assert (q == [[1, 0, 0, 0]]).all()
        assert (np_rot.axis_angle_from_quaternion(q) == 0).all()
    assert np.allclose(np_rot.matrix_from_quaternion(np.zeros(4)), np.eye(3))


@pytest.mark.parametrize("angle", ANGLES)
def test_gradient_of_the_matrix_is_right_everywhere(angle):
    vectors = torch.tensor(angle * AXES, dtype=torch.float64, requires_grad=True)
    # gradcheck's defaults: float64 finite differences of step 1e-6
    assert torch.autograd.gradcheck(matrix_from_axis_angle, (vectors,), eps=1e-6, atol=1e-6)


def test_gradient_at_exactly_zero_is_that_of_the_generators():
    vector = torch.zeros(3, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(matrix_from_axis_angle, vector)
    expected = torch.zeros(3, 3, 3)
    for axis, (i, j) in enumerate([(2, 1), (0, 2), (1, 0)]):
        expected[i, j, axis], expected[j, i, axis] = 1, -1
    assert torch.equal(jacobian, expected)


def test_empty_input_gives_empty_output():
    assert np_rot.matrix_from_axis_angle(np.zeros((0, 3))).shape == (0, 3, 3)
    assert matrix_from_axis_angle(torch.zeros(0, 3)).shape == (0, 3, 3)


def test_slerp_takes_the_short_way_and_agrees_with_scipy():
    a, b = Rotation.random(20, random_state=1), Rotation.random(20, random_state=2)
    qa, qb = np.roll(a.as_quat(), 1, -1), -np.roll(b.as_quat(), 1, -1)  # the sign of a quaternion must not matter
    for t in (0.0, 0.3, 1.0):
        got = np_rot.matrix_from_quaternion(np_rot.slerp(qa, qb, np.full(20, t)))
        expected = (a * Rotation.from_rotvec(t * (a.inv() * b).as_rotvec())).as_matrix()
        assert np.abs(got - expected).max() < 1e-12
    same = np_rot.slerp(qa, qa, np.full(20, 0.5))
    assert np.abs(same - qa).max() < 1e-12


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-13), (np.float32, 1e-6), (np.float16, 3e-3)])
def test_the_least_rotation_between_directions(dtype, tolerance):
    """tolerance: a few roundings of the dtype, of numbers up to one."""
    a, b = np.random.default_rng(0).normal(size=(2, 200, 3))
    b[:3], b[3:6], b[6:9] = a[:3], -a[3:6], -a[6:9] + 1e-7 * b[6:9]  # the same, opposite, nearly opposite
    a[9:12], b[9:12] = np.eye(3), -np.eye(3)
    a, b = (v.astype(dtype) * np.asarray([1, 30], dtype)[np.arange(200) % 2, None] for v in (a, b))
    R = np_rot.rotation_between(a, b)
    assert R.dtype == dtype
    R, a, b = (v.astype(np.float64) for v in (R, a, b))
    a, b = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (a, b))
    # 1e-9: below that sine, directions count as opposite
    np.testing.assert_allclose(np.einsum("nab,nb->na", R, a), b, atol=max(tolerance, 1e-9))
    np.testing.assert_allclose(R @ R.swapaxes(1, 2), np.broadcast_to(np.eye(3), R.shape), atol=4 * tolerance)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=4 * tolerance)
    expected = 1 + 2 * np.sum(a * b, -1)  # the trace tells the angle: no rotation that does it turns further
    np.testing.assert_allclose(np.trace(R, axis1=1, axis2=2), expected, atol=4 * tolerance)


def test_the_rotation_between_directions_at_its_extremes():
    x, y, zero = np.eye(3)[0], np.eye(3)[1], np.zeros(3)
    np.testing.assert_allclose(np_rot.rotation_between(y, -y), np.diag([1, -1, -1]), atol=1e-15)  # about x
    np.testing.assert_allclose(np_rot.rotation_between(x, -x), np.diag([-1, 1, -1]), atol=1e-15)  # about y
    for pair in ((zero, x), (x, zero), (zero, zero), (y, y), (1e-320 * y, 1e300 * y)):
        np.testing.assert_array_equal(np_rot.rotation_between(*pair), np.eye(3))
    assert np_rot.rotation_between(np.zeros((0, 3)), y).shape == (0, 3, 3)
    assert np_rot.rotation_between(x, np.zeros((2, 1, 3))).shape == (2, 1, 3, 3)
    assert np.isnan(np_rot.rotation_between(x, np.array([np.nan, 0, 0]))).any()
    quarter = np_rot.rotation_between(1e200 * x, 1e-200 * y)
    np.testing.assert_allclose(quarter, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize("total", [0, 1, 2, 3, 12, 1000])
@pytest.mark.parametrize("count", [1, 2, 3, 12, 999])
def test_evenly_spaced_picks(total, count):
    picks = evenly_spaced(total, count)
    assert len(picks) == min(total, count)
    assert picks.dtype.kind == "i"
    if total:
        assert picks[0] == 0
    if len(picks) > 1:
        assert picks[-1] == total - 1
        gaps = np.diff(picks)
        assert gaps.min() >= 1
        assert np.ptp(gaps) <= 1
