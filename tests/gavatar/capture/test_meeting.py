"""A body that stands elsewhere than the masks' person is told in one sentence, with its likely cause."""

from __future__ import annotations

import dataclasses
import json
import warnings

import numpy as np
import pytest
from tiny_capture import SMALL, demo, write_tiny_capture

from gavatar.capture.capture import View, read_capture
from gavatar.capture.check import check_capture
from gavatar.capture.meeting import HEAD, LIMB, apart, silhouette
from gavatar.capture.opening import open_capture
from gavatar.registry import BODIES, load_plugins
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.motions.upright import y_up
from gavatar_runtime.notes import Note
from gavatar_runtime.values.camera import Camera

load_plugins()
OPENGL = np.diag([1.0, -1, -1, 1])


@pytest.fixture(scope="module")
def body():
    return BODIES.build("free").data


def _cameras(capture, change):
    cameras = {
        n: dataclasses.replace(c, T_camera_world=change(c.T_camera_world.copy())) for n, c in capture.cameras.items()
    }
    return dataclasses.replace(capture, cameras=cameras)


def _motion(capture, **fields):
    return dataclasses.replace(capture, motion=dataclasses.replace(capture.motion, **fields))


def _far(factor):
    def change(T):
        T[:3, 3] *= factor
        return T

    return change


def _running(capture, offset):
    """A camera that pans with the person by more than a body's width a frame, and poses that lag behind it."""
    aside = 1.5 * np.arange(len(capture.motion))
    moving = {}
    for view in capture.views("train"):
        camera = capture.camera(view)
        T = camera.T_camera_world.copy()
        T[:3, 3] -= T[:3, 0] * aside[view.frame]
        moving[view] = dataclasses.replace(camera, T_camera_world=T)
    trans = capture.motion.trans.copy()
    trans[:, 0] += aside
    moved = dataclasses.replace(capture, moving=moving)
    return _motion(moved, poses=np.roll(capture.motion.poses, offset, 0), trans=np.roll(trans, offset, 0))


def _turned(capture):
    """The same footage in a world turned by 120 degrees: the inverse of the demo's own camera is that camera again."""
    R = matrix_from_axis_angle(np.array([0, 2 * np.pi / 3, 0]))
    turn, pelvis, motion = np.eye(4), BODIES.build("free").data.shaped(None)[1][0], capture.motion
    turn[:3, :3] = R
    poses = motion.poses.astype(float)
    poses[:, 0] = axis_angle_from_matrix(R @ matrix_from_axis_angle(poses[:, 0]))
    turned = _motion(capture, poses=poses, trans=(motion.trans + pelvis) @ R.T - pelvis)
    return _cameras(turned, lambda T: T @ turn.T)


WRONG = {
    "axes of OpenGL": (lambda c: _cameras(c, lambda T: OPENGL @ T), "look along -z: give OpenCV's axes"),
    # after eth-ait/4d-dress #3, where cameras of another convention put the mesh beside the person
    "OpenGL's poses": (lambda c: _cameras(c, lambda T: np.linalg.inv(OPENGL @ T)), "inverted and look along -z"),
    "camera to world": (lambda c: _cameras(_turned(c), np.linalg.inv), "give world to camera, not camera to world"),
    "poses in centimetres": (lambda c: _motion(c, trans=c.motion.trans * 100), "translations are centimetres"),
    "cameras in millimetres": (lambda c: _cameras(c, _far(1000)), "cameras' translations are millimetres"),
    # after skhu101/GauHuman #53: cameras in metres read as ZJU-MoCap's millimetres
    "cameras in kilometres": (lambda c: _cameras(c, _far(1e-3)), "metres taken for millimetres"),
    "y down": (lambda c: dataclasses.replace(c, motion=y_up(c.motion, "-y")), "has -y up"),
    "two frames late": (lambda c: _running(c, 2), "2 frames later"),
    "one frame early": (lambda c: _running(c, -1), "1 frame earlier"),
    # after tijiang13/InstantAvatar #79: refined poses with the camera of another estimate
    "another camera": (lambda c: dataclasses.replace(c, cameras={
        n: dataclasses.replace(v, fx=v.fx / 2.5, fy=v.fy / 2.5) for n, v in c.cameras.items()}), "focal lengths 2."),
    "elsewhere": (lambda c: _motion(c, trans=c.motion.trans + np.float32([3, 0, 0])), "look at the axes and units"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_was_mistaken_is_named(body, case):
    change, words = WRONG[case]
    sentence = apart(change(read_capture(demo())), body, read_capture(demo()).views("train"))
    assert sentence is not None
    assert words in sentence, sentence
    assert "\n" not in sentence


def test_a_sound_capture_meets_in_every_split(body):
    capture = read_capture(demo())
    for views in capture.splits.values():
        assert apart(capture, body, views) is None
    assert apart(_turned(capture), body, capture.views("train")) is None
    assert apart(_running(capture, 0), body, capture.views("train")) is None


def test_nothing_is_said_where_nothing_can_be_compared(body, tmp_path):
    tiny = write_tiny_capture(tmp_path / "tiny")
    capture = _motion(read_capture(tiny), trans=np.full_like(read_capture(tiny).motion.trans, 1e6))
    assert apart(capture, body, []) is None
    views = capture.views("train")
    assert apart(capture, body, views[:1]) is not None  # one view is enough
    for view in views[:4]:
        capture.mask_path(view).unlink()
    assert apart(capture, body, views) is None  # two of six: their own faults are told


def test_the_silhouette_is_as_wide_as_a_person_and_holds_what_is_seen_alone():
    parents = np.array([-1, 0, *range(1, 21)])
    joints = np.zeros((22, 3))
    joints[:, 1] = np.linspace(-0.8, 0.8, 22)
    T = np.eye(4)
    T[2, 3] = 4.0
    camera = Camera(128, 128, 200, 200, 64, 64, T)
    drawn = silhouette(joints, camera, parents)
    # by hand: 200 / 4 pixels a metre; a pixel on either side for whole pixels
    assert abs(drawn[44].sum() - LIMB * 50) <= 2
    row = round(64 + joints[15, 1] * 50)
    assert abs(drawn[row].sum() - 2 * HEAD * 50) <= 2
    T = T.copy()
    T[2, 3] = -4.0  # behind
    assert not silhouette(joints, dataclasses.replace(camera, T_camera_world=T), parents).any()
    for odd in (np.full((22, 3), np.nan), np.full((22, 3), 1e30), np.zeros((22, 3))):
        assert silhouette(odd, dataclasses.replace(camera, width=1, height=1), parents).shape == (1, 1)


def test_the_check_names_it_and_training_notes_it_before_it_starts(tmp_path):
    from gavatar.config import check, compose_config
    from gavatar.training.trainer import Trainer

    tiny = write_tiny_capture(tmp_path / "tiny")
    cameras = json.loads((tiny / "cameras.json").read_text())
    cameras["cam0"]["world_to_camera"] = (OPENGL @ np.array(cameras["cam0"]["world_to_camera"])).tolist()
    assert check_capture(tiny).faults == []
    (tiny / "cameras.json").write_text(json.dumps(cameras))
    faults = check_capture(tiny).faults
    assert len(faults) == 1
    assert "do not meet" in faults[0]
    config = check(compose_config([f"capture={tiny}", "encoder=none", *[s for s in SMALL if "encoder" not in s]]))
    with pytest.warns(Note, match="do not meet.*not OpenGL's"):
        Trainer(config, tmp_path)


def test_another_layouts_mistake_is_told_in_its_own_world(tmp_path, body):
    """The placement turns a camera's axes into the capture's: the inverse is taken before it."""
    import foreign_captures as write

    person = tmp_path / "person"
    person.mkdir()
    write.instantavatar(person)
    with np.load(person / "cameras.npz") as file:
        arrays = dict(file)
    arrays["extrinsic"] = np.linalg.inv(np.array([[1, 0, 0, 0.9], [0, 0, -1, 0.4], [0, 1, 0, 3], [0, 0, 0, 1.0]]))
    np.savez(person / "cameras.npz", **arrays)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Note)
        capture = open_capture(person).placed(body)
    assert isinstance(capture.views("train")[0], View)
    assert "do not meet" in apart(capture, body, capture.views("train"))
