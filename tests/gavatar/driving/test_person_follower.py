"""The networks and the fit together, on pictures of the shipped demo capture, and on pictures of nobody."""

from __future__ import annotations

import importlib.resources

import numpy as np
import pytest

from gavatar.driving.causal_fit import Fitted
from gavatar.driving.live_skeleton import LiveSkeleton
from gavatar.driving.person_follower import LOOK, PersonFollower, Standing
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.live.drivers import build_driver

cv2 = pytest.importorskip("cv2", reason="reads pictures")


@pytest.fixture(scope="module")
def follower():
    return PersonFollower(load_free_body())


@pytest.fixture(scope="module")
def picture():
    folder = importlib.resources.files("gavatar.data") / "studio_demo/images"
    camera = sorted(folder.iterdir(), key=lambda p: p.name)[0]
    first = sorted(camera.iterdir(), key=lambda p: p.name)[0]
    return cv2.imdecode(np.frombuffer(first.read_bytes(), np.uint8), cv2.IMREAD_COLOR)


def test_a_person_stands_on_the_floor(follower, picture):
    follower.reset()
    for k in range(3):
        seen = follower(picture, k / 30)
    assert seen.pose.shape == (22, 3)
    assert seen.points.shape == (33, 2)
    assert 0.6 < seen.leg_length < 1.1
    assert seen.points[0, 1] < seen.points[23, 1] < seen.points[27, 1], "nose, hip, ankle from the top"
    assert np.abs(seen.trans).max() < 0.15
    assert np.abs(seen.pose[0]).max() < 0.6, "faces the camera"


def test_nobody(follower):
    follower.reset()
    for size in ((480, 640), (1, 1), (3, 2000)):
        for k in range(3):
            assert follower(np.full((*size, 3), 127, np.uint8), k / 30) is None


def test_somebody_leaves_and_comes_back(follower, picture):
    follower.reset()
    empty = np.full_like(picture, 255)
    assert follower(picture, 0.0) is not None
    assert follower(empty, 0.03) is None
    assert follower(empty, 0.06) is None
    assert follower(picture, 0.07) is None, "not looked for so soon"
    assert follower(picture, 0.07 + 2 * LOOK) is not None


def test_another_size_is_another_camera(follower, picture):
    follower.reset()
    assert follower(picture, 0.0) is not None
    assert follower(cv2.resize(picture, None, fx=0.5, fy=0.5), 0.03) is not None


def test_the_registered_driver(picture):
    driver = build_driver()
    assert driver(picture, 0.0) is not None
    assert driver.lines
    driver.reset()
    assert driver(np.zeros_like(picture), 0.0) is None


def test_a_jump_leaves_the_floor_and_a_tilted_camera_does_not():
    skeleton = LiveSkeleton.of(load_free_body())
    still = np.tile(np.eye(3), (22, 1, 1))
    _, joints, points = skeleton.posed(still)

    def at(place) -> Fitted:
        return Fitted(still, joints + place, points + place, np.asarray(place, float))

    standing = Standing()
    assert standing(at((0.3, -0.2, -4.0)), skeleton, 0.0, False) == pytest.approx([0, 0, 0])
    assert standing(at((0.4, -0.2, -4.1)), skeleton, 0.1, False)[[0, 2]] == pytest.approx([0, 0]), "not measured yet"
    assert standing(at((0.5, -0.2, -4.0)), skeleton, 0.2, True) == pytest.approx([0.1, 0, 0.1])
    assert standing(at((0.5, 0.1, -4.0)), skeleton, 0.3, True)[1] == pytest.approx(0.3 - 0.1 * Standing.RISE)
    for k in range(40):  # standing higher for good: the picture's, not the person's
        last = standing(at((0.5, 0.1, -4.0)), skeleton, 0.4 + k / 10, True)
    assert last[1] == pytest.approx(0)
