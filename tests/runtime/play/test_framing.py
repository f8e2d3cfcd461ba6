"""Cameras of the player: framing a motion, circling it, and reading camera files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import DEMO

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.camera_file import read_camera, read_cameras
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import MARGIN, body_points, facing, fitted_to, frame_motion, orbit
from gavatar_runtime.values.camera import Camera, look_at

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import make_bundle, still


@pytest.fixture(scope="module")
def static(tmp_path_factory):
    return make_bundle(tmp_path_factory.mktemp("static") / "tester.gavatar")


@pytest.mark.parametrize("size", [(512, 512), (320, 640), (640, 200), (1, 1)])
@pytest.mark.parametrize("azimuth", [0, 90, 200])
def test_the_whole_motion_is_in_the_picture_and_fills_it(static, size, azimuth):
    avatar = Avatar(static)
    motion, _ = avatar.fit(read_motion("wave", fps=6))
    camera = frame_motion(avatar, motion, *size, azimuth=azimuth)
    x, y, z = camera.project(body_points(avatar, motion)).T
    low, high = MARGIN - 1e-8, 1 - MARGIN + 1e-8  # NumPy 1 rounds a product of scalars to float32
    assert (z > 0).all()
    assert low <= (x / size[0]).min()
    assert (x / size[0]).max() <= high
    assert low <= (y / size[1]).min()
    assert (y / size[1]).max() <= high
    # one side touches its margin: the person is as large as fits
    slack = min((x / size[0]).min() - MARGIN, 1 - MARGIN - (x / size[0]).max(),
                (y / size[1]).min() - MARGIN, 1 - MARGIN - (y / size[1]).max())  # fmt: skip
    assert slack == pytest.approx(0, abs=1e-6)


def test_a_person_who_stays_in_place_is_seen_from_their_front(static):
    avatar = Avatar(static)
    for yaw in (0, 1.5, np.pi, -2.5):
        motion = still()
        motion.poses[0, 0] = (0, yaw, 0)
        eye = frame_motion(avatar, motion, 64, 64).position
        assert np.arctan2(eye[0], eye[2]) == pytest.approx(facing(motion), abs=0.02)  # the body is not symmetric
        assert np.cos(facing(motion) - yaw) == pytest.approx(1, abs=1e-6)


def test_a_person_lying_down_is_seen_along_the_world_axis():
    motion = still()
    motion.poses[0, 0] = (-np.pi / 2, 0, 0)
    assert facing(motion) == 0


def test_an_orbit_keeps_the_person_in_the_picture(static):
    avatar = Avatar(static)
    motion, _ = avatar.fit(read_motion("wave", fps=6))
    camera = frame_motion(avatar, motion, 100, 60, orbit=True)
    points = body_points(avatar, motion)
    target = (points.min(0) + points.max(0)) / 2
    cameras = orbit(camera, target, np.arange(8) / 8)
    np.testing.assert_allclose(cameras[0].T_camera_world, camera.T_camera_world, atol=1e-12)
    distances = [np.linalg.norm(c.position - target) for c in cameras]
    np.testing.assert_allclose(distances, distances[0])
    angles = np.unwrap([np.arctan2(*(c.position - target)[[0, 2]]) for c in cameras])
    np.testing.assert_allclose(angles - angles[0], 2 * np.pi * np.arange(8) / 8)
    for c in cameras:
        x, y, z = c.project(points).T
        assert (z > 0).all()
        # 36 sampled directions leave at most a hair of the margin to chance
        assert (x / 100).min() > -0.01
        assert (x / 100).max() < 1.01
        assert ((y > 0) & (y < 60)).all()


@given(st.integers(1, 300), st.integers(1, 300))
def test_a_camera_fitted_to_another_size_keeps_its_picture_whole_and_undistorted(width, height):
    camera = Camera(120, 80, 100, 90, 50, 45, look_at((0, 0, 3), (0, 0, 0)))
    fitted = fitted_to(camera, width, height)
    assert (fitted.width, fitted.height) == (width, height)
    assert fitted.fx / fitted.fy == pytest.approx(camera.fx / camera.fy)
    factor = min(width / 120, height / 80)
    corners = np.array([[0, 0], [120, 80]]) * factor + [(width - 120 * factor) / 2, (height - 80 * factor) / 2]
    assert corners.min() >= -1e-5
    assert (corners[1] <= (width + 1e-5, height + 1e-5)).all()
    point = np.array([0.1, 0.2, 0.3])
    expected = camera.project(point)[:2] * factor + corners[0]
    np.testing.assert_allclose(fitted.project(point)[:2], expected, atol=1e-9)


def test_cameras_of_a_capture_are_read_by_name():
    cameras = read_cameras(DEMO / "cameras.json")
    assert set(cameras) == {"cam0", "cam1", "cam2"}
    one = read_camera(f"{DEMO / 'cameras.json'}:cam1")
    np.testing.assert_array_equal(one.T_camera_world, cameras["cam1"].T_camera_world)
    assert read_camera(str(DEMO / "cameras.json")).T_camera_world is not None


def camera_json(**changes):
    entry = {"width": 4, "height": 3, "fx": 5, "fy": 5, "cx": 2, "cy": 1.5, "world_to_camera": np.eye(4).tolist()}
    return {k: v for k, v in (entry | changes).items() if v is not None}


def test_one_camera_by_itself_is_a_camera_file_too(tmp_path):
    (tmp_path / "c.json").write_text(json.dumps(camera_json()))
    assert read_camera(str(tmp_path / "c.json")).width == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "holds no camera"),
        ("{}", "holds no camera"),
        (json.dumps({"a": 3}), "'a' must be an object"),
        (json.dumps({"a": camera_json(fx=None)}), "'a' has no field 'fx'"),
        (json.dumps({"a": camera_json(fx="wide")}), "wrong type"),
        (json.dumps({"a": camera_json(fx=0)}), "must be positive"),
        (json.dumps({"a": camera_json(width=float("nan"))}), "must be positive"),
        (json.dumps({"a": camera_json(world_to_camera=[[1]])}), "4x4"),
        (json.dumps({"a": camera_json(world_to_camera=np.full((4, 4), np.nan).tolist())}), "finite 4x4"),
    ],
)
def test_a_faulty_camera_file_names_file_camera_and_field(tmp_path, text, message):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(UserError, match=message) as raised:
        read_cameras(tmp_path / "c.json")
    assert "c.json" in str(raised.value)


def test_an_absent_camera_or_camera_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"c\.json does not exist"):
        read_camera(str(tmp_path / "c.json"))
    with pytest.raises(UserError, match=r"no camera 'cam9': choose from: cam0, cam1, cam2; did you mean"):
        read_camera(f"{DEMO / 'cameras.json'}:cam9")
