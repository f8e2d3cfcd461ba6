"""Image metrics by name and by mask; joint errors under every similarity."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from gavatar.images.metrics import (
    joint_errors,
    lpips_metric,
    masked,
    mean_psnr,
    mpjpe,
    mpjpe_hands,
    pa_mpjpe,
    perceptual_metric,
    psnr,
    rotation_errors,
    ssim,
)
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.values.skeletons import FINGERS, SMPLH


@pytest.fixture
def joints() -> np.ndarray:
    """(6, 22, 3) metres."""
    return np.random.default_rng(0).normal(scale=0.5, size=(6, 22, 3))


def similarity(joints: np.ndarray, seed: int = 1) -> np.ndarray:
    """Every frame turned, scaled and moved by its own similarity."""
    rng = np.random.default_rng(seed)
    turn = matrix_from_axis_angle(rng.normal(size=(len(joints), 3)) * 2)
    scale, move = rng.uniform(0.3, 3, (len(joints), 1, 1)), rng.normal(size=(len(joints), 1, 3))
    return scale * joints @ turn.swapaxes(1, 2) + move


# ---------------------------------------------------------------- images


def test_the_mean_of_psnr_is_capped_so_that_one_identical_frame_does_not_swallow_it():
    x = torch.rand(1, 3, 8, 8)
    assert psnr(x, x).item() == math.inf
    assert mean_psnr([psnr(x, x), 30.0]) == 65
    assert mean_psnr([130.0], cap=120) == 120
    assert math.isnan(mean_psnr([]))


def test_psnr_of_a_tiny_error_does_not_drown_in_float32():
    x = torch.full((1, 3, 32, 32), 0.5)
    y = x + 2.0**-20  # exact in float32
    assert psnr(x, y).item() == pytest.approx(20 * math.log10(2**20), abs=1e-9)


def test_a_masked_metric_sees_only_the_box_of_the_mask():
    torch.manual_seed(0)
    x, y = torch.rand(2, 3, 30, 20), torch.rand(2, 3, 30, 20)
    mask = torch.zeros(2, 30, 20)
    mask[0, 4:20, 2:15] = 1
    mask[1, 29, 19] = 0.6  # a single pixel in the corner
    boxes = [(slice(4, 20), slice(2, 15)), (slice(29, 30), slice(19, 20))]
    expected = torch.cat([psnr(x[b : b + 1, :, r, c], y[b : b + 1, :, r, c]) for b, (r, c) in enumerate(boxes)])
    assert torch.equal(masked(psnr, x, y, mask), expected)
    grown = masked(ssim, x, y, mask, margin=3)
    assert torch.allclose(grown[:1], ssim(x[:1, :, 1:23, :18], y[:1, :, 1:23, :18]))
    assert torch.allclose(grown[1:], ssim(x[1:, :, 26:, 16:], y[1:, :, 26:, 16:]))


def test_an_empty_mask_is_a_users_mistake():
    x = torch.rand(1, 3, 4, 4)
    with pytest.raises(UserError, match="mask 0 of the batch is empty"):
        masked(psnr, x, x, torch.full((1, 4, 4), 0.5))


def test_the_perceptual_metric_says_what_it_is():
    metric, name = perceptual_metric()
    assert "EfficientNet-Lite0" in name
    assert "lpips" not in name.lower()
    x = torch.rand(2, 3, 40, 50, requires_grad=True)
    assert torch.equal(metric(x, x), torch.zeros(2))
    assert not metric(x, x.flip(0)).requires_grad


def test_lpips_says_what_it_lacks(tmp_path):
    with pytest.raises(UserError, match="there is no file"):
        lpips_metric("vgg", backbone=str(tmp_path / "vgg16-397923af.pth"))


# ---------------------------------------------------------------- joints


def test_mpjpe_is_the_mean_distance_in_millimetres(joints):
    moved = joints.copy()
    moved[:, 3] += [0.022, 0, 0]  # one of 22 joints by 22 mm
    assert mpjpe(moved, joints) == pytest.approx(np.full(6, 1.0))
    assert mpjpe(joints + np.array([1, 2, 3]), joints) == pytest.approx(np.zeros(6), abs=1e-9)
    assert mpjpe(joints + np.array([3, 0, 4]), joints, root=None) == pytest.approx(np.full(6, 5000.0))


def test_only_the_body_joints_count(joints):
    hands = np.concatenate([joints, joints[:, :5] + 9], 1)
    other = np.concatenate([joints, joints[:, :5]], 1)
    assert joint_errors(hands, other) == pytest.approx((0, 0), abs=1e-9)


def test_pa_mpjpe_is_blind_to_similarity_and_to_nothing_else(joints):
    # float64 SVD of 22 points of size one, in mm
    assert pa_mpjpe(similarity(joints), joints) == pytest.approx(np.zeros(6), abs=1e-9)
    noisy = joints + 0.02 * np.random.default_rng(5).normal(size=joints.shape)
    errors = pa_mpjpe(similarity(noisy), joints)
    assert errors == pytest.approx(pa_mpjpe(noisy, joints))
    assert (errors > 10).all()
    assert (errors < mpjpe(noisy, joints, root=None) * 1.05).all()


def test_pa_mpjpe_does_not_mirror(joints):
    mirrored = joints * [-1, 1, 1]
    assert (pa_mpjpe(mirrored, joints) > 50).all()


def test_the_fitted_similarity_is_the_best_one(joints):
    """No nearby similarity has a smaller sum of squares than the one that the closed form finds."""
    rng = np.random.default_rng(2)
    for truth in (joints[:1], joints[:1] * [-1, 1, 1]):
        noisy = joints[:1] + 0.1 * rng.normal(size=(1, 22, 3))
        start = _aligned(noisy, truth)
        best = np.square(start - truth).sum()
        for _ in range(200):
            turn = matrix_from_axis_angle(0.01 * rng.normal(size=3))
            nearby = (1 + 0.01 * rng.normal()) * start @ turn.T + 0.01 * rng.normal(size=3)
            assert np.square(nearby - truth).sum() > best


def _aligned(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """What pa_mpjpe compares with the truth, found from its errors alone would be circular: Umeyama step by step."""
    x, y = joints[0] - joints[0].mean(0), truth[0] - truth[0].mean(0)
    u, s, vt = np.linalg.svd(y.T @ x / len(x))
    d = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(s) @ d) / (np.square(x).sum() / len(x))
    aligned = scale * x @ (u @ d @ vt).T + truth[0].mean(0)
    assert pa_mpjpe(joints, truth)[0] == pytest.approx(1000 * np.linalg.norm(aligned - truth[0], axis=1).mean())
    return aligned[None]


@pytest.mark.parametrize("flat", [0, 1, 2, 3])
def test_pa_mpjpe_of_degenerate_joints(joints, flat):
    """Joints in a plane, on a line, in one point: still exact where a similarity exists, never NaN."""
    truth = joints.copy()
    truth[..., 3 - flat :] = 0
    assert pa_mpjpe(similarity(truth), truth) == pytest.approx(np.zeros(6), abs=1e-6)
    collapsed = np.zeros_like(joints)
    centre = truth.mean(1, keepdims=True)
    expected = 1000 * np.linalg.norm(truth - centre, axis=-1).mean(1)
    assert pa_mpjpe(collapsed, truth) == pytest.approx(expected)


def test_frames_that_are_not_finite_score_nan_and_leave_the_others(joints):
    broken = joints.copy()
    broken[2, 5] = np.nan
    broken[4, 0, 0] = np.inf
    assert np.isnan(pa_mpjpe(broken, joints)).tolist() == [False, False, True, False, True, False]
    assert pa_mpjpe(broken, joints)[[0, 1, 3, 5]] == pytest.approx(np.zeros(4), abs=1e-9)


def test_one_frame_and_float32_do(joints):
    frame = joints[:1].astype(np.float32)
    assert joint_errors(frame, joints[:1]) == pytest.approx((0, 0), abs=1e-3)  # float32 metres: 1e-7 m


def test_joints_of_other_shapes_are_refused(joints):
    with pytest.raises(ValueError, match="must both be"):
        mpjpe(joints, joints[:, :20])


def test_rotation_errors_are_angles_whatever_the_axis_angle_says():
    poses = np.array([[0, 0, 0.0], [np.pi, 0, 0], [0, 3 * np.pi / 2, 0], [0, 0, 2 * np.pi], [0.3, 0, 0]])
    truth = np.array([[0, 0, 0.0], [-np.pi, 0, 0], [0, -np.pi / 2, 0], [0, 0, 0], [0.3, 0, 0.0]])
    np.testing.assert_allclose(rotation_errors(poses, truth), 0, atol=1e-6)
    assert rotation_errors(np.zeros(3), np.array([0, np.pi, 0])) == pytest.approx(180)
    assert rotation_errors(np.array([0.1, 0, 0]), np.zeros(3)) == pytest.approx(np.degrees(0.1))


def test_hands_are_compared_from_their_wrists():
    names = SMPLH
    truth = np.random.default_rng(0).normal(size=(3, 52, 3))
    carried = truth.copy()
    for side in ("left", "right"):
        rows = [names.index(n) for n in names if n.startswith(side) and (n in FINGERS or n.endswith("wrist"))]
        carried[:, rows] += np.random.default_rng(1).normal(size=(3, 1, 3))
    np.testing.assert_allclose(mpjpe_hands(carried, truth, names), 0, atol=1e-9)
    moved = truth.copy()
    moved[:, names.index("right_thumb3")] += (0, 0.03, 0)
    np.testing.assert_allclose(mpjpe_hands(moved, truth, names), 1.0)  # 30 mm over 30 joints
    assert np.isnan(mpjpe_hands(truth[:, :22], truth[:, :22], SMPLH[:22])).all()
