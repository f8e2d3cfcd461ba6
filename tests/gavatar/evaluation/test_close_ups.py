"""Close-ups look at what they name, from where they say, whichever way the person faces."""

import numpy as np
import pytest

from gavatar.evaluation.close_ups import CLOSE_UPS, close_up_cameras

JOINTS = ("pelvis", "spine2", "head", "left_wrist")
HEIGHTS = {"pelvis": 0.95, "spine2": 1.25, "head": 1.6, "left_wrist": 0.9}


def standing(turn: float = 0.0) -> np.ndarray:
    """(4, 4, 4) transforms of a person who stands turned by `turn` radians about the vertical."""
    transforms = np.tile(np.eye(4), (len(JOINTS), 1, 1))
    cos, sin = np.cos(turn), np.sin(turn)
    transforms[:, :3, :3] = [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]
    for transform, name in zip(transforms, JOINTS, strict=True):
        transform[1, 3] = HEIGHTS[name]
    return transforms


@pytest.mark.parametrize("turn", [0.0, 1.0, np.pi, -2.5])
def test_cameras_see_what_they_name(turn):
    trans = np.array([0.3, 0.1, -2.0])
    transforms = standing(turn)
    cameras = dict(close_up_cameras(JOINTS, transforms, trans, 200))
    assert list(cameras) == [close_up.title for close_up in CLOSE_UPS]
    forward = np.array([np.sin(turn), 0, np.cos(turn)])
    for close_up in CLOSE_UPS:
        camera, joint = cameras[close_up.title], transforms[JOINTS.index(close_up.joint), :3, 3] + trans
        x, y, depth = camera.project(joint + np.array([0, close_up.height, 0]))
        assert (x, y) == pytest.approx((100, 100))
        assert camera.fx * close_up.size / depth == pytest.approx(200)  # the picture spans that many metres
        towards = (camera.position - joint) @ forward
        assert towards < 0 if close_up.title == "back" else towards > 0


def test_joints_that_a_body_lacks_are_left_out():
    assert [title for title, _ in close_up_cameras(("pelvis", "head"), standing()[[0, 2]], np.zeros(3), 64)] == [
        "face", "hem",
    ]  # fmt: skip
    assert close_up_cameras(("root",), standing()[:1], np.zeros(3), 64) == []


def test_a_person_lying_down_is_seen_from_somewhere():
    lying = standing()
    lying[:, :3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # what was forward points up
    for _, camera in close_up_cameras(JOINTS, lying, np.zeros(3), 64):
        assert np.isfinite(camera.T_camera_world).all()
