"""Rotations, kinematics and skinning at the ends of their numbers, in NumPy and in torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gavatar.avatar.torch_skinning import can_skin_sparse, skin_rotations, skin_sparse
from gavatar.avatar.torch_skinning import skin as torch_skin
from gavatar.body.skeleton import joint_transforms as torch_transforms
from gavatar.body.torch_rotations import matrix_from_axis_angle as torch_matrix
from gavatar_runtime.geometry import kinematics
from gavatar_runtime.geometry.rotations import (
    axis_angle_from_matrix,
    matrix_from_axis_angle,
    quaternion_from_axis_angle,
)
from gavatar_runtime.geometry.skinning import skin

AXES = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [0.6, 0.0, -0.8], [2 / 3, -2 / 3, 1 / 3]])
ANGLES = [0.0, 1e-7, 1e-4, 1e-2, 1.0, np.pi, 2 * np.pi, 3 * np.pi, 100.0, 300.0, 1000.0]
# a dozen roundings of numbers up to one
ROUNDING = {np.float16: 2e-3, np.float32: 2e-6, np.float64: 1e-14}


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("dtype", ROUNDING)
def test_rotations_of_any_angle_in_every_precision(dtype, angle):
    """The rotation of the vector as the precision holds it; Rodrigues in float64 is the reference."""
    vectors = (AXES * angle).astype(dtype)
    exact = vectors.astype(np.float64)
    t = np.linalg.norm(exact, axis=-1)[:, None, None]
    x, y, z = (exact / np.where(t[..., 0] == 0, 1, t[..., 0])).T
    o = np.zeros_like(x)
    K = np.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(-1, 3, 3)
    expected = np.eye(3) + np.sin(t) * K + (1 - np.cos(t)) * K @ K
    # beyond a few turns, the angle itself is known to its own rounding only; float16 is computed in float32
    own = np.finfo(np.promote_types(dtype, np.float32)).eps * angle
    for name, got in (
        ("numpy", matrix_from_axis_angle(vectors)),
        ("torch", torch_matrix(torch.from_numpy(vectors)).numpy()),
    ):
        assert got.dtype == dtype, name
        np.testing.assert_allclose(got.astype(np.float64), expected, atol=4 * ROUNDING[dtype] + own, err_msg=name)
    assert np.linalg.norm(quaternion_from_axis_angle(vectors).astype(np.float64), axis=-1) == pytest.approx(
        np.ones(len(AXES)), abs=ROUNDING[dtype]
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rotations_that_are_no_numbers_stay_none_and_spoil_no_other(dtype):
    vectors = np.array([[np.nan, 0, 0], [0, 1, 0], [np.inf, 0, 0]], dtype)
    with np.errstate(invalid="ignore"):
        both = matrix_from_axis_angle(vectors), torch_matrix(torch.from_numpy(vectors)).numpy()
    for got in both:
        assert np.isnan(got[0]).any()
        assert np.isfinite(got[1]).all()
        assert np.isnan(got[2]).any()
    assert axis_angle_from_matrix(np.zeros((0, 3, 3), dtype)).shape == (0, 3)


# Skeletons


def both(poses, joints, parents):
    """World transforms (..., J, 4, 4) by both halves, which agree."""
    T = kinematics.joint_transforms(poses, joints, parents)
    rotations = torch_matrix(torch.from_numpy(poses))
    R, p = torch_transforms(rotations, torch.from_numpy(joints), list(parents))
    np.testing.assert_allclose(R.numpy(), T[..., :3, :3], atol=1e-12)
    np.testing.assert_allclose(p.numpy(), T[..., :3, 3], atol=1e-12)
    return T


def test_a_skeleton_of_one_joint_turns_in_place():
    T = both(np.array([[0.0, np.pi, 0.0]]), np.array([[1.0, 2.0, 3.0]]), np.array([-1]))
    np.testing.assert_allclose(T[0], [[-1, 0, 0, 1], [0, 1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize("parents", [[-1, 0, 1, 2], [-1, 0, 0, 0], [-1, -1, -1, -1]], ids=["chain", "star", "roots"])
def test_joints_in_one_place_stay_there(parents):
    rng = np.random.default_rng(0)
    place = np.array([0.5, -1.0, 2.0])
    T = both(rng.normal(size=(3, 4, 3)), np.tile(place, (4, 1)), np.array(parents))
    np.testing.assert_allclose(T[..., :3, 3], np.broadcast_to(place, (3, 4, 3)), atol=1e-12)
    A = kinematics.skinning_transforms(T, np.tile(place, (4, 1)))
    np.testing.assert_allclose(A[..., :3, :3] @ place + A[..., :3, 3], np.broadcast_to(place, (3, 4, 3)), atol=1e-12)


def test_a_long_chain_and_no_pose_at_all():
    joints = np.arange(200.0)[:, None] * [0.0, 0.01, 0.0]
    parents = np.arange(-1, 199)
    poses = np.zeros((200, 3))
    poses[0] = [0, 0, 2 * np.pi]
    np.testing.assert_allclose(both(poses, joints, parents)[:, :3, 3], joints, atol=1e-12)
    assert both(np.zeros((0, 200, 3)), joints, parents).shape == (0, 200, 4, 4)


# Weights


def test_a_point_without_weights_goes_to_the_origin_in_both_halves():
    """It is refused when a body is read (`whole_weights`); the functions themselves stay linear."""
    rng = np.random.default_rng(1)
    points, A = rng.normal(size=(4, 3)), rng.normal(size=(3, 4, 4))
    index = np.zeros((4, 2), np.int32)
    weight = np.array([[0, 0], [1, 0], [0, 0], [0.5, 0.5]])
    dense = np.zeros((4, 3))
    dense[[1, 3], 0] = 1
    got = {
        "numpy": kinematics.skin(points, index, weight, A),
        "kernel or numpy": skin(points.astype(np.float32), index, weight.astype(np.float32), A.astype(np.float32)),
        "torch": torch_skin(*(torch.from_numpy(x) for x in (points, dense, A[:, :3]))).numpy(),
    }
    arrays = [torch.from_numpy(x) for x in (points[None], index, weight, A[None, :, :3])]
    arrays = [x.float() if x.is_floating_point() else x for x in arrays]
    if can_skin_sparse(arrays[0]):
        got["torch by kernel"] = skin_sparse(*arrays)[0].numpy()
    for name, moved in got.items():
        assert (moved[[0, 2]] == 0).all(), name
        expected = points[[1, 3]] @ A[0, :3, :3].T + A[0, :3, 3]
        np.testing.assert_allclose(moved[[1, 3]], expected, atol=2e-6, err_msg=name)  # float32


def test_rotations_carried_without_weights_are_finite_with_finite_gradients():
    A = torch.eye(3, 4, dtype=torch.float64).repeat(2, 1, 1).requires_grad_()
    rotations = torch.tensor([[1.0, 0, 0, 0], [0, 1.0, 0, 0]], dtype=torch.float64, requires_grad=True)
    weights = torch.tensor([[0.0, 0.0], [0.3, 0.7]], dtype=torch.float64)
    carried = skin_rotations(rotations, weights, A, [-1, 0])
    assert torch.equal(carried[0], torch.zeros(4, dtype=torch.float64))
    torch.testing.assert_close(carried[1], rotations[1].detach())
    carried.sum().backward()
    assert torch.isfinite(A.grad).all()
    assert torch.isfinite(rotations.grad).all()
