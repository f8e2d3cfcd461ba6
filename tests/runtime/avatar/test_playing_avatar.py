"""Posing an exported avatar: what the networks decode, and where skinning carries it."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.decoding.uv_maps import positional_map
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry import kinematics
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.values.motion import Motion

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import DECODER_GAIN, ENCODER_GAIN, free_body, make_bundle, still


@pytest.fixture(scope="module")
def static(tmp_path_factory):
    return make_bundle(tmp_path_factory.mktemp("static") / "tester.gavatar")


@pytest.fixture(scope="module")
def dynamic(tmp_path_factory):
    return make_bundle(tmp_path_factory.mktemp("dynamic") / "tester.gavatar", dynamic=True)


def test_in_the_canonical_pose_the_gaussians_are_where_the_surface_was_sampled(static):
    avatar = Avatar(static)
    gaussians = avatar.gaussians(free_body().canonical_pose())
    # 2e-6 m: float32 positions of about a metre through one blend of rigid transforms
    np.testing.assert_allclose(gaussians.means, avatar.surface.points, atol=2e-6)
    assert gaussians.means.dtype == gaussians.colors.dtype == gaussians.scales.dtype == np.float32
    assert gaussians.opacities is None
    assert gaussians.quaternions is None


def test_posing_is_the_bodys_own_skinning_of_the_offset_canonical_points(tmp_path):
    avatar = Avatar(make_bundle(tmp_path / "a.gavatar", offset=0.03))
    pose = np.random.default_rng(0).normal(0, 0.4, (52, 3))
    trans = np.array([1.0, -2.0, 3.0])
    body, surface = free_body(), avatar.surface
    A = body.skinning(pose) @ np.linalg.inv(body.skinning(body.canonical_pose()))
    points = surface.points.astype(np.float64) + 0.03
    expected = kinematics.skin(points, surface.joint_index, surface.joint_weight.astype(np.float64), A) + trans
    # 5e-6 m: float32 of positions up to 4 m
    np.testing.assert_allclose(avatar.gaussians(pose, trans).means, expected, atol=5e-6)


def test_a_dynamic_avatar_decodes_the_positional_map_of_each_pose(dynamic):
    avatar = Avatar(dynamic)
    _, map_surface = avatar.bundle.surfaces()
    seen = []
    for angle in (0.0, 0.8):
        pose = np.zeros((52, 3), np.float32)
        pose[16] = (0, 0, -angle)
        shift = DECODER_GAIN * ENCODER_GAIN * positional_map(map_surface, pose).mean((0, 1))
        A = avatar.surface.skin_transforms(pose)
        points = avatar.surface.points + shift
        expected = kinematics.skin(points, avatar.surface.joint_index, avatar.surface.joint_weight, A)
        got = avatar.gaussians(pose)
        np.testing.assert_allclose(got.means, expected, atol=2e-6)  # float32 at a metre
        seen.append(shift)
    assert np.abs(seen[0] - seen[1]).max() > 1e-5


def test_where_the_person_stands_and_faces_does_not_change_how_they_look(dynamic):
    avatar = Avatar(dynamic)
    pose = np.random.default_rng(1).normal(0, 0.3, (52, 3)).astype(np.float32)
    pose[0] = 0
    at_home = avatar.gaussians(pose).means - avatar.joints[0]
    turned = pose.copy()
    turned[0] = (0, np.pi, 0)
    away = avatar.gaussians(turned, np.array([10, 0, 5])).means - avatar.joints[0] - (10, 0, 5)
    R = matrix_from_axis_angle(np.array([0, np.pi, 0]))
    np.testing.assert_allclose(away, at_home @ R.T, atol=1e-5)  # float32 at ten metres


def test_two_pi_is_no_rotation_and_pi_is_one(static):
    avatar = Avatar(static)
    pose = np.zeros((52, 3), np.float32)
    rest = avatar.gaussians(pose).means
    pose[0, 1] = 2 * np.pi
    np.testing.assert_allclose(avatar.gaussians(pose).means, rest, atol=2e-6)
    pose[0, 1] = np.pi
    np.testing.assert_allclose(avatar.gaussians(pose).means[:, 1], rest[:, 1], atol=2e-6)


def test_normals_turn_with_the_body(static):
    avatar = Avatar(static)
    pose = np.zeros((len(avatar.joint_names), 3), np.float32)
    assert avatar.gaussians(pose).normals is None
    before = avatar.gaussians(pose, normals=True)
    pose[avatar.surface.root] = (0, np.pi, 0)
    after = avatar.gaussians(pose, np.float32([1, 2, 3]), normals=True).normals
    np.testing.assert_allclose(after, before.normals * [-1, 1, -1], atol=1e-5)  # float32 sines of pi
    assert np.linalg.norm(after, axis=1).max() < 1 + 1e-3  # float16 in the bundle


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_pose_that_is_no_number_names_its_joint(static, value):
    avatar = Avatar(static)
    pose = np.zeros((52, 3))
    pose[4, 1] = value
    with pytest.raises(UserError, match="'left_knee' is NaN or infinite"):
        avatar.gaussians(pose)
    with pytest.raises(UserError, match="translation is NaN"):
        avatar.gaussians(np.zeros((52, 3)), np.array([0, value, 0]))
    motion = still(3)
    motion.poses[2, 4, 1] = value
    with pytest.raises(UserError, match="NaN or infinite pose at frame 2"):
        avatar.fit(motion)


@pytest.mark.parametrize("joints", [22, 24, 52, 55])
def test_poses_of_other_skeletons_are_fitted(static, joints):
    avatar = Avatar(static)
    pose = np.zeros((joints, 3))
    pose[18] = (0, -1, 0)
    same = np.zeros((52, 3))
    same[18] = (0, -1, 0)
    np.testing.assert_array_equal(avatar.gaussians(pose).means, avatar.gaussians(same).means)
    fitted, ignored = avatar.fit(Motion(np.full((2, joints, 3), 0.1, np.float32), np.zeros((2, 3)), 30.0))
    assert fitted.poses.shape == (2, 52, 3)
    expected = {24: {"left_hand", "right_hand"}, 55: {"jaw", "left_eye_smplhf", "right_eye_smplhf"}}
    assert set(ignored) == expected.get(joints, set())


@pytest.mark.parametrize("pose", [np.zeros(156), np.zeros((52, 4)), np.zeros((1, 52, 3))])
def test_a_pose_of_another_shape_is_a_bug(static, pose):
    with pytest.raises(ValueError, match=r"expected \(J, 3\)"):
        Avatar(static).gaussians(pose)


def test_threads_must_be_positive_and_do_not_change_the_result(dynamic):
    with pytest.raises(UserError, match="threads=0"):
        Avatar(dynamic, threads=0)
    pose = np.zeros((52, 3))
    one, two = (Avatar(dynamic, threads=n).gaussians(pose) for n in (1, 2))
    np.testing.assert_allclose(one.means, two.means, atol=1e-6)  # a sum may be split among threads
