"""Kinematics and skinning: NumPy and torch agree, with gradients right at zero and pi."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import gavatar.body.skeleton
from gavatar.avatar.torch_skinning import dense_weights
from gavatar.avatar.torch_skinning import skin as torch_skin
from gavatar.body.skeleton import Skeleton
from gavatar.body.torch_rotations import matrix_from_axis_angle
from gavatar.registry import BODIES, load_plugins
from gavatar_runtime.geometry.kinematics import invert_rigid, joint_transforms, skin
from gavatar_runtime.values.motion import Motion


@pytest.fixture(scope="module")
def body():
    load_plugins()
    return BODIES.build("free").data


def poses(count=4, joints=52, seed=0) -> np.ndarray:
    values = np.random.default_rng(seed).normal(size=(count, joints, 3)) * 0.4
    values[0] = 0
    values[1, :, 0], values[1, :, 1:] = np.pi, 0
    return values


def test_the_free_body_is_a_valid_smplh_shaped_body(body):
    assert body.num_joints == 52
    assert body.joint_names[:2] == ("pelvis", "left_hip")
    assert np.abs(body.lbs_weights.sum(1) - 1).max() < 1e-5  # stored in float32
    assert (body.parents[1:] < np.arange(1, 52)).all()
    assert body.faces.max() < len(body.v_template)
    assert body.uv_faces.max() < len(body.uv)


def test_zero_pose_is_the_rest_shape(body):
    betas = np.linspace(-1, 1, 10)
    vertices, joints = body.posed(np.zeros((52, 3)), betas)
    rest, rest_joints = body.shaped(betas)
    assert np.abs(vertices - rest).max() < 1e-6  # float32 weights that sum to one within 1e-7, times two metres
    assert np.abs(joints - rest_joints).max() < 1e-12


def test_torch_kinematics_agree_with_numpy(body):
    betas = np.array([0.5, -1.0, 2.0])
    values = poses()
    skeleton = Skeleton(body, betas, torch.float64)
    rotations = matrix_from_axis_angle(torch.from_numpy(values))
    _, joints = body.shaped(betas)
    expected = joint_transforms(values, joints, body.parents)
    R, p = gavatar.body.skeleton.joint_transforms(rotations, skeleton.joints, skeleton.parents)
    # float64 through chains of at most ten matrices
    assert np.abs(R.numpy() - expected[..., :3, :3]).max() < 1e-12
    assert np.abs(p.numpy() - expected[..., :3, 3]).max() < 1e-12
    linear, offset = skeleton.skinning(rotations)
    A = body.skinning(values, betas)
    assert np.abs(linear.numpy() - A[..., :3, :3]).max() < 1e-12
    assert np.abs(offset.numpy() - A[..., :3, 3]).max() < 1e-12


def test_canonical_to_posed_is_live_times_inverse_canonical(body):
    skeleton = Skeleton(body, None, torch.float64)
    values = poses()
    got = skeleton.canonical_to_posed(matrix_from_axis_angle(torch.from_numpy(values))).numpy()
    expected = body.skinning(values) @ invert_rigid(body.skinning(body.canonical_pose()))
    assert np.abs(got - expected[..., :3, :]).max() < 1e-12
    still = skeleton.canonical_to_posed(matrix_from_axis_angle(torch.from_numpy(body.canonical_pose()))).numpy()
    assert np.abs(still - np.eye(4)[:3]).max() < 1e-12


def test_dense_and_sparse_skinning_agree_in_both_halves():
    rng = np.random.default_rng(3)
    index = rng.integers(0, 5, (40, 3)).astype(np.int32)  # repeated joints in a row must add up
    weight = rng.random((40, 3))
    weight /= weight.sum(1, keepdims=True)
    A = rng.normal(size=(5, 4, 4))
    points = rng.normal(size=(40, 3))
    expected = skin(points, index, weight, A)
    dense = dense_weights(index, weight, 5)
    got = torch_skin(torch.from_numpy(points), torch.from_numpy(dense), torch.from_numpy(A[:, :3]))
    assert np.abs(got.numpy() - expected).max() < 1e-12
    assert torch_skin(torch.zeros(0, 3), torch.zeros(0, 5), torch.zeros(5, 3, 4)).shape == (0, 3)


@pytest.mark.parametrize("angle", [0.0, np.pi, 2 * np.pi])
def test_gradients_through_the_skeleton_at_special_angles(body, angle):
    skeleton = Skeleton(body, None, torch.float64)
    vectors = torch.zeros(22, 3, dtype=torch.float64)
    vectors[:, 1] = angle
    vectors.requires_grad_(True)

    def joints(v):
        full = torch.cat([v, v.new_zeros(30, 3)])
        return skeleton.posed_joints(matrix_from_axis_angle(full))[[4, 15, 20, 21]]

    assert torch.autograd.gradcheck(joints, (vectors,), eps=1e-6, atol=1e-6)


def test_resampling_a_motion_keeps_its_ends_and_crosses_pi_smoothly():
    angles = np.linspace(3.0, 3.3, 4)  # passes pi
    values = np.zeros((4, 1, 3))
    values[:, 0, 1] = np.where(angles > np.pi, angles - 2 * np.pi, angles)
    motion = Motion(values, np.arange(12.0).reshape(4, 3), 10.0)
    dense = motion.resampled(20.0)
    assert len(dense) == 7
    turned = np.mod(dense.poses[:, 0, 1], 2 * np.pi)
    assert np.abs(turned - np.linspace(3.0, 3.3, 7)).max() < 1e-9
    assert np.allclose(dense.trans[[0, -1]], motion.trans[[0, -1]])
    one = Motion(values[:1], np.zeros((1, 3)), 10.0).resampled(60.0)
    assert len(one) == 1
