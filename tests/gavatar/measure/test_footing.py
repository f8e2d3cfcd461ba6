"""Feet on the floor: the measure itself, and the built-in motions by it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from make_bundle import free_body

from gavatar.measure.footing import footing
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.fitting import scaled_to_legs
from gavatar_runtime.values.motion import Motion

# metres: a fifth of what an eye sees on a person who fills the picture (one pixel of 512 is 4 mm)
SLIDE, SUNK = 0.005, 0.001


def still(frames: int = 11, fps: float = 10.0) -> Motion:
    return Motion(np.zeros((frames, 52, 3), np.float32), np.zeros((frames, 3), np.float32), fps)


def on_free_body(name: str, **options) -> Motion:
    body = free_body()
    return scaled_to_legs(read_motion(name, **options), body.joint_names, body.shaped(None)[1])


def test_who_stands_does_not_slide():
    found = footing(free_body(), still())
    assert found.stances == 2
    assert found.slide == found.speed == found.flight == 0
    assert found.sunk < 1e-6


def test_a_slide_is_measured_and_a_floor_that_moves_along_takes_it_away():
    motion = still()
    motion.trans[:, 2] = -0.5 * np.arange(11) / 10  # half a metre a second, backwards
    found = footing(free_body(), motion)
    assert found.slide == pytest.approx(0.5, abs=1e-5)
    assert found.speed == pytest.approx(0.5, abs=1e-4)
    assert footing(free_body(), motion, floor_speed=0.5).slide < 1e-5


def test_who_is_sunk_or_aloft_is_found():
    for height, sunk, flight in ((-0.02, 0.02, 0), (0.1, 0, 1)):
        motion = still()
        motion.trans[:, 1] = height
        found = footing(free_body(), motion)
        assert found.sunk == pytest.approx(sunk, abs=1e-5)
        assert found.flight == flight


@pytest.mark.parametrize(
    ("name", "options", "floor"),
    [
        ("idle", {}, 0), ("stretch", {}, 0), ("dance", {}, 0), ("jump", {}, 0), ("jump", {"forward": 0.8}, 0),
        ("walk", {}, 1.35), ("walk", {"travel": True}, 0), ("walk", {"speed": 0.5}, 0.5), ("walk", {"speed": 2.0}, 2.0),
        ("run", {}, 2.8), ("run", {"travel": True}, 0), ("run", {"speed": 4.5}, 4.5),
    ],
)  # fmt: skip
def test_feet_of_built_in_motions_neither_slide_nor_sink(name, options, floor):
    motion = on_free_body(name, fps=60, **options)
    found = footing(free_body(), motion, floor_speed=floor)
    assert found.stances >= 2
    assert found.slide < SLIDE
    assert found.sunk < SUNK
    assert (found.flight > 0.1) == (name in ("run", "jump"))


def test_on_a_body_of_other_size_feet_do_not_slide_either():
    body = free_body()
    small = dataclasses.replace(body, v_template=0.7 * body.v_template, shapedirs=0.7 * body.shapedirs)
    motion = scaled_to_legs(read_motion("walk", fps=60), small.joint_names, small.shaped(None)[1])
    assert footing(small, motion, floor_speed=0.7 * 1.35).slide < SLIDE
