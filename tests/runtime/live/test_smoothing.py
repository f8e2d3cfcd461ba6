"""Less tremble at a stated delay."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.live.smoothing import LONGEST, Cutoff, Places, Rotations, blended

STEADY = Cutoff(rest=2.0, rise=0.0)  # whose delay does not change with speed


def about_z(angle) -> np.ndarray:
    return np.array([[0.0, 0.0, angle]])


def run(smooth, values, times):
    return np.array([smooth(v, t) for v, t in zip(values, times, strict=True)])


@pytest.mark.parametrize("pose", [np.zeros((3, 3)), np.array([[np.pi, 0, 0], [0, 3.0, 0], [0.1, -0.2, 0.3]])])
def test_constant_in_constant_out(pose):
    shown = run(Rotations(), [pose] * 20, np.arange(20) / 30)
    assert np.abs(matrix_from_axis_angle(shown) - matrix_from_axis_angle(pose)).max() < 1e-7
    places = run(Places(), [np.array([1.0, 2, -3])] * 20, np.arange(20) / 30)
    assert np.array_equal(places, np.tile([1.0, 2, -3], (20, 1)))


def test_a_step_is_shown_by_63_percent_after_the_stated_delay():
    """In the limit of many pictures: at 1000 a second the first-order filter is that of continuous time to 1 %."""
    times = np.arange(0, 0.5, 0.001)
    steps = [about_z(0.0 if t == 0 else 0.8) for t in times]
    shown = run(Rotations(STEADY), steps, times)[:, 0, 2] / 0.8
    assert shown[np.searchsorted(times, STEADY.delay())] == pytest.approx(1 - np.exp(-1), abs=0.01)
    places = run(Places(STEADY), [np.array([0.0 if t == 0 else 2.0, 0, 0]) for t in times], times)[:, 0] / 2
    assert places[np.searchsorted(times, STEADY.delay())] == pytest.approx(1 - np.exp(-1), abs=0.01)


@pytest.mark.parametrize("rate", [10, 30, 240])
def test_what_moves_steadily_is_late_by_the_stated_delay(rate):
    """At any rate of pictures: the filter's lag behind a ramp is its time constant exactly."""
    times = np.arange(0, 3, 1 / rate)
    speed = 0.7
    cutoff = Cutoff(rest=2.0, rise=1.5)
    shown = run(Rotations(cutoff), [about_z(speed * t) for t in times], times)[-1, 0, 2]
    assert times[-1] - shown / speed == pytest.approx(cutoff.delay(speed), rel=1e-3)
    place = run(Places(cutoff), [np.array([speed * t, 0, 0]) for t in times], times)[-1, 0]
    assert times[-1] - place / speed == pytest.approx(cutoff.delay(speed), rel=1e-3)


def test_irregular_times_are_those_they_are():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.005, 0.1, 200))
    shown = run(Rotations(STEADY), [about_z(0.2 * t) for t in times], times)[-1, 0, 2]
    # the last steps' lengths decide how late it is: between none and twice the delay
    assert 0 < times[-1] - shown / 0.2 < 2 * STEADY.delay()


def test_noise_is_less():
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.02, (200, 5, 3))
    shown = run(Rotations(), noise, np.arange(200) / 30)
    assert shown[20:].std() < 0.6 * noise[20:].std()


def test_nan_stays_as_it_was():
    smooth, places = Rotations(), Places()
    smooth(np.array([[0.1, 0, 0], [0.2, 0, 0]]), 0.0)
    places(np.array([1.0, 0, 0]), 0.0)
    held = smooth(np.array([[np.nan, 0, 0], [0.3, 0, 0]]), 0.1)
    assert held[0] == pytest.approx([0.1, 0, 0])
    assert 0.2 < held[1, 0] <= 0.3
    assert np.array_equal(places(np.full(3, np.inf), 0.1), [1, 0, 0])
    assert np.isfinite(smooth(np.array([[0.1, 0, 0], [0.3, 0, 0]]), 0.2)).all()


def test_nan_first_is_rest():
    assert np.array_equal(Rotations()(np.full((2, 3), np.nan), 0.0), np.zeros((2, 3)))
    assert np.array_equal(Places()(np.full(3, np.nan), 0.0), np.zeros(3))


@pytest.mark.parametrize("time", [1.0, 0.5, -3.0])
def test_a_time_that_is_not_later_changes_nothing(time):
    smooth, places = Rotations(), Places()
    smooth(about_z(0.5), 1.0)
    places(np.ones(3), 1.0)
    assert smooth(about_z(2.0), time)[0, 2] == pytest.approx(0.5)
    assert np.array_equal(places(np.zeros(3), time), np.ones(3))


def test_after_a_long_gap_the_new_is_taken():
    smooth = Rotations(STEADY)
    smooth(about_z(0.0), 0.0)
    assert smooth(about_z(1.0), 100 * LONGEST)[0, 2] == pytest.approx(1.0, abs=0.01)


def test_the_shortest_way_over_half_a_turn():
    smooth = Rotations(STEADY)
    smooth(about_z(3.1), 0.0)
    shown = smooth(about_z(-3.1), 0.05)[0, 2]  # 0.08 further, not 6.2 back
    assert abs(shown) > 3.1


def test_blending_of_two_poses():
    a, b = np.array([[0.0, 0, 0.2], [np.pi, 0, 0]]), np.array([[0.0, 0, 0.8], [0.0, 0, 0]])
    assert blended(a, b, 0.0) == pytest.approx(a)
    assert blended(a, b, 1.0) == pytest.approx(b, abs=1e-9)
    assert blended(a, b, 0.5)[0] == pytest.approx([0, 0, 0.5])
    assert np.linalg.norm(blended(a, b, 0.5)[1]) == pytest.approx(np.pi / 2)
