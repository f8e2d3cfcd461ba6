"""Pictures in, poses out: who is there, who is gone, what ends."""

from __future__ import annotations

import time

import numpy as np
import pytest
from live_people import Told, raised

from gavatar_runtime.avatar.played_body import PlayedBody
from gavatar_runtime.errors import UserError
from gavatar_runtime.live.following import HOLD, RELAX, Following, Steadied
from gavatar_runtime.motions.builtin import relaxed_pose
from gavatar_runtime.values.skeletons import SMPLH

RATE = 30


@pytest.fixture
def body():
    return PlayedBody(SMPLH, np.zeros((52, 3)), None, None, 0)


def steady(body, people, angle=0.6):
    """What is shown of pictures in which somebody is there or not."""
    steadied, told = Steadied(body), Told(lambda k: raised(angle) if people[k] else None)
    return [steadied(told(None, k / RATE), k / RATE) for k in range(len(people))]


def test_one_picture(body):
    pose, trans, state = steady(body, [True])[0]
    assert state == "following"
    assert pose.shape == (52, 3)
    assert pose[16] == pytest.approx([0, 0, 0.6])
    assert np.array_equal(trans, np.zeros(3))


def test_nobody_from_the_start_is_idle(body):
    shown = steady(body, [False] * 5)
    idle = Steadied(body).idle
    for k, (pose, _, state) in enumerate(shown):
        assert state == "idle"
        assert pose == pytest.approx(idle.poses[int(k / RATE * idle.fps) % len(idle)])


def test_who_is_gone_is_held_then_relaxes_and_comes_back(body):
    gone = int((HOLD + RELAX + 0.5) * RATE)
    shown = steady(body, [True] * 10 + [False] * gone + [True] * 30)
    states = [state for *_, state in shown]
    held = [k for k, state in enumerate(states) if state == "holding"]
    assert held[0] == 10
    assert len(held) == pytest.approx(HOLD * RATE, abs=2)
    for k in held:
        assert shown[k][0][16, 2] == pytest.approx(0.6, abs=1e-6)
    angles = np.array([pose[16, 2] for pose, *_ in shown])
    idle = relaxed_pose()[16, 2]
    assert angles[9 + gone] == pytest.approx(idle, abs=0.15)  # an idle motion may breathe
    assert np.abs(np.diff(angles[:-31])).max() < 2.5 * (0.6 - idle) / (RELAX * RATE)  # no jump
    assert states[-1] == "following"
    assert angles[-1] == pytest.approx(0.6, abs=1e-3)


def test_nan_of_a_driver_is_refused_by_the_body(body):
    """A driver's NaN is a fault of its own: it ends the following with a sentence and does not reach an avatar."""
    with Running(body, Told(lambda k: np.full((22, 3), np.nan))) as following:
        following.give(np.zeros((4, 4, 3), np.uint8))
        end = time.monotonic() + 5
        while not following.ended and time.monotonic() < end:
            time.sleep(0.01)
        assert "NaN" in following.ended
        assert following.newest() is None


class Running:
    def __init__(self, *arguments):
        self.following = Following(*arguments)

    def __enter__(self):
        return self.following

    def __exit__(self, *exception):
        self.following.close()
        assert not self.following._thread.is_alive()


def test_pictures_that_are_given(body):
    with Running(body, Told()) as following:
        assert following.newest() is None
        assert following.newest(0, 0.01) is None
        for k in range(3):
            assert following.give(np.full((4, 6, 3), k, np.uint8), tag=10 + k)
            shown = following.newest(k, 5)
            assert (shown.number, shown.tag, shown.picture[0, 0, 0]) == (k + 1, 10 + k, k)
        assert following.newest(3, 0.01).number == 3


class Clip:
    """A source of three pictures that can be begun again, or not."""

    name, camera = "clip", None

    def __init__(self, again: bool):
        self.goes_on, self.k, self.closed = again, 0, False

    def read(self):
        self.k += 1
        time.sleep(0.002)
        return None if self.k % 4 == 0 else (np.zeros((4, 4, 3), np.uint8), self.k / RATE)

    def again(self):
        return self.goes_on

    def close(self):
        self.closed = True


def test_a_clip_begins_again_and_the_person_anew(body):
    told, clip = Told(), Clip(True)
    with Running(body, told, clip) as following:
        assert following.newest(7, 5).number >= 8
        assert following.rounds > 1
        assert told.resets >= 1
        assert not following.ended
    assert clip.closed


def test_a_camera_that_ends_says_so(body):
    clip = Clip(False)
    with Running(body, Told(), clip) as following:
        following._thread.join(5)
        assert following.ended == "clip gives no more pictures"
        assert following.newest().number == 3
    assert clip.closed


def test_a_driver_that_refuses_ends_with_its_sentence(body):
    def refuse(k):
        raise UserError("no network here")

    with Running(body, Told(refuse), Clip(True)) as following:
        following._thread.join(5)
        assert following.ended == "no network here"
