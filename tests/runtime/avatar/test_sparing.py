"""Work that a scene does not need: joints that rest, Gaussians that no camera sees, memory that is there already."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from gavatar_runtime import native_library
from gavatar_runtime.avatar.folding import folded, still_joints
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.avatar.visibility import seen_from
from gavatar_runtime.geometry.skinning import skin
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.play.outputs.nowhere import Nowhere
from gavatar_runtime.play.player import play_images
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.values.camera import Camera, look_at
from gavatar_runtime.values.motion import Motion

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import free_body, make_bundle, surface_of


def motion_of(poses: np.ndarray) -> Motion:
    return Motion(poses.astype(np.float32), np.zeros((len(poses), 3), np.float32), 30.0)


# still joints


@pytest.mark.parametrize("moving", [(), (0,), (15,), tuple(range(22)), (37,), tuple(range(52))])
def test_folded_joints_carry_every_point_to_the_same_place(moving):
    surface = surface_of(free_body(), 500, 64)
    rng = np.random.default_rng(0)
    poses = np.zeros((3, 52, 3), np.float32)
    poses[:, list(moving)] = rng.normal(0, 1, (3, len(moving), 3))
    still = still_joints(surface, poses)
    assert not still[list(moving)].any()
    # the hips are bent in the canonical pose: held straight, they are not where they were sampled
    assert set(np.flatnonzero(~still)) == {0, 1, 2, *moving}
    small, kept = folded(surface, still)
    assert small.joint_weight.shape[1] <= surface.joint_weight.shape[1]
    np.testing.assert_allclose(small.joint_weight.sum(1), 1, atol=1e-5)
    for pose in poses:
        expected = skin(surface.points, surface.joint_index, surface.joint_weight, surface.skin_transforms(pose))
        A = small.skin_transforms(pose[kept])
        # float32 sums in another order, a metre from the origin
        np.testing.assert_allclose(skin(small.points, small.joint_index, small.joint_weight, A), expected, atol=2e-6)


def test_a_bent_joint_is_folded_only_where_nothing_below_it_moves():
    surface = surface_of(free_body(), 50, 64)
    pose = np.repeat(free_body().canonical_pose()[None], 2, 0)
    assert still_joints(surface, pose)[1:].all()  # as sampled: all but the root
    pose[1, 4] = (0.3, 0, 0)  # a knee, below the hip that the canonical pose bends
    still = still_joints(surface, pose)
    assert not still[[1, 4]].any()
    assert still[2]
    assert not still_joints(surface, pose)[0]


def test_an_avatar_that_follows_a_motion_is_right_in_any_other_pose(tmp_path):
    avatar, plain = (Avatar(make_bundle(tmp_path / "a.gavatar")) for _ in range(2))
    poses = np.zeros((4, 52, 3), np.float32)
    poses[:, 16, 2] = np.linspace(0, 1, 4)
    avatar.follow(motion_of(poses))
    other = poses[0].copy()
    other[30] = (1, 0, 0)  # a finger that the motion holds still
    for pose in (poses[3], other):
        np.testing.assert_allclose(avatar.gaussians(pose).means, plain.gaussians(pose).means, atol=2e-6)


# what a camera can see


def sphere(count: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    return (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)


def test_the_far_side_of_a_ball_is_left_out_and_the_near_side_never():
    normals = sphere()
    camera = Camera(64, 64, 60.0, 60.0, 32.0, 32.0, look_at(np.array([0, 0, 3.0]), np.zeros(3)))
    rows = seen_from(normals, normals, camera, facing=0.3)
    toward = np.array([0, 0, 3.0]) - normals
    cosine = (toward * normals).sum(1) / np.linalg.norm(toward, axis=1)
    np.testing.assert_array_equal(rows, np.flatnonzero(cosine >= -0.3))
    unknown = np.full_like(normals, np.nan)
    assert len(seen_from(normals, unknown, camera)) == len(normals)


@pytest.mark.parametrize("distance", [0.05, 3.0, 100.0])
def test_what_no_pixel_shows_is_left_out_and_what_one_shows_never(distance):
    rng = np.random.default_rng(1)
    points = rng.uniform(-3, 3, (5000, 3)).astype(np.float32)
    normals = np.zeros_like(points)  # turned nowhere
    eye = np.array([0.2, 0.1, distance])
    camera = Camera(80, 48, 90.0, 90.0, 30.0, 25.0, look_at(eye, np.zeros(3)))
    T = camera.T_camera_world
    x, y, z = T[:3, :3] @ points.T.astype(np.float64) + T[:3, 3:]
    rows = seen_from(points, normals, camera)
    with np.errstate(divide="ignore"):
        px, py = 90 * x / z + 30, 90 * y / z + 25
    shown = np.flatnonzero((z > 0) & (px >= 0) & (px <= 80) & (py >= 0) & (py <= 48))
    assert np.isin(shown, rows).all()
    assert len(rows) < len(points) or distance > 50
    behind = Camera(80, 48, 90.0, 90.0, 30.0, 25.0, look_at(np.array([0, 0, 9.0]), np.array([0, 0, 20.0])))
    assert len(seen_from(points, normals, behind)) == 0
    assert seen_from(points[:0], normals[:0], camera).shape == (0,)


# memory


@pytest.mark.skipif(not native_library.available()[0], reason=native_library.available()[1])
@pytest.mark.parametrize("options", [{}, {"reuse": 3}, {"gaussians": 5000}])
def test_playing_makes_no_array_of_the_size_of_the_avatar_in_any_frame(tmp_path, options):
    count = 20000
    avatar = Avatar(make_bundle(tmp_path / "a.gavatar", count, dynamic=True), **options)
    poses = np.zeros((3, 52, 3), np.float32)
    poses[:, 16, 2] = (0, 0.5, 1)
    motion = motion_of(poses)
    camera, renderer = frame_motion(avatar, motion, 256, 256), Renderer(avatar)

    many = motion_of(np.tile(poses, (8, 1, 1)))
    play_images(renderer, many, camera, Nowhere())
    before = []

    def progress(done: int, total: int) -> None:
        if done == 6:
            before.append(tracemalloc.get_traced_memory()[0])
            tracemalloc.reset_peak()

    tracemalloc.start()
    try:
        play_images(renderer, many, camera, Nowhere(), progress=progress)
        peak = tracemalloc.get_traced_memory()[1] - before[0]
    finally:
        tracemalloc.stop()
    # small things; a float for each Gaussian would be 80 kB, and a byte for each pixel's channels 197 kB
    assert peak < 60_000
