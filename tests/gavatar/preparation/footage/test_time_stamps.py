"""A constant rate from time stamps: the even stay as they are, the uneven are taken by time."""

import numpy as np
import pytest

from gavatar.preparation.footage.time_stamps import even_clock


def test_even_stamps_change_nothing():
    for rate in (10.0, 24000 / 1001, 30.0, 240.0):
        stamps = np.arange(50) / rate
        for noise in (0, 0.0005):  # whole milliseconds, as webm has them
            timing = even_clock(np.round(stamps / noise) * noise if noise else stamps, rate, 50)
            assert (timing.even, timing.rate, timing.note) == (True, rate, None)


def test_a_header_that_disagrees_is_not_believed():
    timing = even_clock(np.arange(60) / 30, 1000.0, 60)
    assert timing.even
    assert timing.rate == pytest.approx(30)
    assert timing.note == "the file says 1000 frames a second, its time stamps 30, which is taken"


@pytest.mark.parametrize("stamps", [None, np.zeros(5), np.full(5, np.nan), np.array([0, 2, 1, 3, 4.0]), np.arange(4.0)])
def test_stamps_that_say_nothing_leave_the_header(stamps):
    assert even_clock(stamps, 25.0, 5).rate == 25.0
    assert even_clock(stamps, None, 5).rate is None
    unknown = even_clock(stamps, 1000.0, 5)
    assert (unknown.rate, unknown.even) == (None, True)
    assert "no camera films" in unknown.note


@pytest.mark.parametrize("count", [1, 2])
def test_one_and_two_frames(count):
    timing = even_clock(np.arange(count) / 10, 10.0, count)
    assert (timing.order.tolist(), timing.rate) == (list(range(count)), 10.0)


def test_each_moment_takes_the_nearest_frame():
    rng = np.random.default_rng(1)
    stamps = np.cumsum(rng.choice([0.02, 0.033, 0.1], 200))
    timing = even_clock(stamps, 30.0, 200)
    assert not timing.even
    clock = stamps[0] + np.arange(len(timing.order)) / timing.rate
    np.testing.assert_array_equal(np.abs(stamps[timing.order] - clock), np.abs(stamps[None] - clock[:, None]).min(1))
    assert (np.diff(timing.order) >= 0).all()


def test_a_long_pause_does_not_make_a_film_of_one_picture():
    stamps = np.r_[np.arange(10) / 30, 3600 + np.arange(10) / 30]
    assert len(even_clock(stamps, 30.0, 20).order) < 100
