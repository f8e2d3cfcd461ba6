"""Smoothness and closeness of the motion, and the rotation vectors that they rest on."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from loss_inputs import motion

from gavatar.body.torch_rotations import matrix_from_axis_angle, rotation_vector_from_matrix
from gavatar.losses import LossInputs, MotionState
from gavatar.registry import LOSSES, load_plugins
from gavatar_runtime.errors import UserError

load_plugins()


def smoothness(state: MotionState, **options) -> float | None:
    inputs = LossInputs(render=None, target=None, alpha=None, mask=None, motion=state)
    value = LOSSES.build("motion_smoothness", options)(inputs)
    return None if value is None else value.item()


def swing(times: np.ndarray) -> np.ndarray:
    """(T, 2, 3) a joint that swings to and fro and one that turns steadily, at any time in seconds."""
    poses = np.zeros((len(times), 2, 3))
    poses[:, 0, 0] = 0.5 * np.sin(2 * np.pi * times)
    poses[:, 1, 1] = 2.0 * times
    return poses


def test_smoothness_is_the_squared_acceleration_at_every_frame_rate():
    # mean over one period of (0.5 (2 pi)^2 sin)^2 is half the squared amplitude; the second joint adds nothing
    expected = (0.5 * (2 * np.pi) ** 2 / 30**2) ** 2 / 2 / 2
    for fps in (24, 30, 60, 120):
        times = np.arange(4 * fps + 1) / fps
        # a second difference loses (2 pi / fps)^2 / 12 of the amplitude: at 24 fps 1.2 % of its square
        assert smoothness(motion(swing(times), fps=fps)) == pytest.approx(expected, rel=0.015)


def test_robust_smoothness_is_square_for_small_and_linear_for_large_accelerations():
    for angle, robust in ((1e-4, 1.0), (1.0, 1e-4)):
        poses = np.zeros((3, 1, 3))
        poses[1, 0, 0] = angle  # one triplet; at 30 frames a second the acceleration is twice the angle
        expected = (2 * angle) ** 2 if robust > angle else 2 * robust * 2 * angle
        # the next term of the series is a quarter of (small / large)^2, or half of small / large: 1e-4 at most
        assert smoothness(motion(poses), robust=robust) == pytest.approx(expected, rel=1e-4)
    assert smoothness(motion(np.zeros((5, 2, 3))), robust=0.002) == 0


def test_robust_smoothness_has_a_gradient_at_rest():
    state = motion(torch.zeros(5, 2, 3))
    state.rotations.requires_grad_()
    LOSSES.build("motion_smoothness", {"robust": 0.002})(
        LossInputs(render=None, target=None, alpha=None, mask=None, motion=state)
    ).backward()
    assert torch.isfinite(state.rotations.grad).all()


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_an_impossible_bend_of_the_smoothness_is_refused(value):
    with pytest.raises(UserError, match="robust"):
        LOSSES.build("motion_smoothness", {"robust": value})


def test_smoothness_bears_gaps_of_held_out_frames():
    times = np.arange(121) / 30
    kept = np.array([i for i in range(121) if i % 5 != 2])
    whole = smoothness(motion(swing(times), times=times))
    gappy = smoothness(motion(swing(times[kept]), times=times[kept]))
    assert gappy == pytest.approx(whole, rel=0.05)  # coarser differences at the gaps
    steady = np.stack([2.0 * times[kept], 0 * times[kept], 0 * times[kept]], -1)[:, None]
    walking = np.stack([1.5 * times[kept], 0 * times[kept], 0 * times[kept]], -1)
    # steady turning and walking are free however frames are spaced: rounding of float64
    assert smoothness(motion(steady, trans=walking, times=times[kept])) < 1e-20


def test_smoothness_leaves_out_what_lies_across_a_long_gap():
    times = np.concatenate([np.arange(10), np.arange(300, 310)]) / 30
    poses = np.zeros((20, 1, 3))
    poses[10:, 0, 2] = 1.0  # it moved while nobody looked
    assert smoothness(motion(poses, times=times)) == 0
    assert smoothness(motion(poses[:3], times=np.array([0.0, 5, 10]))) is None
    assert smoothness(motion(poses[:2])) is None
    assert smoothness(motion(poses[:1])) is None


def test_smoothness_sees_jitter_and_survives_flips_and_repeated_times():
    rng = np.random.default_rng(0)
    times = np.arange(60) / 30
    calm, jittered = swing(times), swing(times) + 0.03 * rng.normal(size=(60, 2, 3))
    assert smoothness(motion(jittered)) > 20 * smoothness(motion(calm))
    flipped = calm.copy()
    flipped[30:, 1, 1] += np.pi
    angle = torch.tensor(flipped, requires_grad=True)
    state = motion(angle, times=np.sort(np.concatenate([times[:59], times[10:11]])))
    value = LOSSES.build("motion_smoothness")(LossInputs(render=None, target=None, alpha=None, mask=None, motion=state))
    value.backward()
    assert value.item() > 0.1
    assert torch.isfinite(angle.grad).all()


@pytest.mark.parametrize("wrap", [2 * np.pi, -2 * np.pi])
def test_motion_losses_do_not_see_the_axis_angle_wrap(wrap):
    poses = np.zeros((5, 1, 3))
    poses[:, 0, 1] = np.linspace(3.0, 3.3, 5)  # across pi
    wrapped = poses.copy()
    wrapped[3:, 0, 1] -= wrap
    assert smoothness(motion(wrapped)) == pytest.approx(smoothness(motion(poses)), abs=1e-12)


def test_the_prior_is_the_squared_angle_when_small_and_flat_at_pi():
    zero = torch.zeros(3, 2, 3, dtype=torch.float64)
    for angle, expected in ((1e-3, 1e-6), (1.0, 2 - 2 * math.cos(1.0)), (math.pi, 4.0)):
        turned = (zero + torch.tensor([angle, 0.0, 0.0])).requires_grad_()
        value = LOSSES.build("motion_prior")(
            LossInputs(render=None, target=None, alpha=None, mask=None, motion=motion(turned, initial=zero))
        )
        # the chord is short of the arc by angle^2 / 12
        assert value.item() == pytest.approx(expected, rel=1e-6)
        value.backward()
        assert torch.isfinite(turned.grad).all()


def test_the_prior_counts_translation_in_square_metres():
    still = motion(torch.zeros(4, 2, 3))
    state = dataclasses.replace(still, trans=still.trans + torch.tensor([0.3, 0.0, 0.4]))
    inputs = LossInputs(render=None, target=None, alpha=None, mask=None, motion=state)
    assert LOSSES.build("motion_prior", {"translation": 2.0})(inputs).item() == pytest.approx(2 * 0.25)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-3, 1.0, 3.0, math.pi - 1e-5])
def test_rotation_vectors_invert_rodrigues(angle, dtype):
    axes = torch.randn(50, 3, dtype=dtype, generator=torch.Generator().manual_seed(0))
    vectors = angle * axes / axes.norm(dim=1, keepdim=True)
    found = rotation_vector_from_matrix(matrix_from_axis_angle(vectors))
    # a few roundings of matrix entries of size one
    assert (found - vectors).abs().max() < 20 * torch.finfo(dtype).eps


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.0, -0.8]])
def test_rotation_vectors_at_pi_give_the_same_rotation(axis):
    matrix = matrix_from_axis_angle(math.pi * torch.tensor(axis, dtype=torch.float64)).requires_grad_()
    vector = rotation_vector_from_matrix(matrix)
    assert vector.norm().item() == pytest.approx(math.pi)
    assert torch.allclose(matrix_from_axis_angle(vector), matrix, atol=1e-14)  # float64 rounding
    vector.sum().backward()
    assert torch.isfinite(matrix.grad).all()


def test_rotation_vectors_have_the_right_gradient():
    def there_and_back(vector):
        return rotation_vector_from_matrix(matrix_from_axis_angle(vector))

    for angle in (0.0, 1e-4, 0.3, 2.0, 3.1):
        x = torch.tensor([[angle, 0.2 * angle, -0.1 * angle]], dtype=torch.float64, requires_grad=True)
        jacobian = torch.autograd.functional.jacobian(
            lambda v: rotation_vector_from_matrix(matrix_from_axis_angle(v)), x
        )
        # the inverse of Rodrigues' formula composed with it is the identity below pi
        if x.norm() < math.pi:
            assert torch.allclose(jacobian[0, :, 0], torch.eye(3, dtype=torch.float64), atol=1e-9)
        assert torch.isfinite(jacobian).all()
