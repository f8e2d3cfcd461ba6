"""The order of Gaussians: a permutation whose every beginning is spread over all of them."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.geometry.ordering import morton_codes, progressive_order


def spread(points: np.ndarray, cells: int = 6) -> np.ndarray:
    """(cells^3,) the share of the points in each cell of a grid over the unit cube."""
    where = np.minimum((points * cells).astype(int), cells - 1)
    counts = np.bincount(where @ (cells * cells, cells, 1), minlength=cells**3)
    return counts / len(points)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 1000, 4097])
def test_every_point_is_taken_once(count):
    order = progressive_order(np.random.default_rng(count).random((count, 3)))
    assert np.array_equal(np.sort(order), np.arange(count))


def test_every_beginning_is_spread_like_the_whole():
    """Closer to the whole's spread than a random choice of as many, whose counts vary as a multinomial's."""
    rng = np.random.default_rng(0)
    points = rng.random((20000, 3)) ** 2  # dense towards a corner
    order, whole = progressive_order(points), spread(points)
    for count in (1000, 3000, 8192, 15000):  # a cell holds five and more
        ours = np.abs(spread(points[order[:count]]) - whole).sum()
        chance = [np.abs(spread(points[rng.permutation(20000)[:count]]) - whole).sum() for _ in range(5)]
        assert ours < 0.8 * min(chance), count


def test_coincident_points_and_a_flat_cloud_have_an_order():
    for points in (np.ones((300, 3)), np.random.default_rng(0).random((300, 3)) * (1, 0, 0)):
        assert np.array_equal(np.sort(progressive_order(points)), np.arange(300))


def test_the_order_is_the_same_each_time():
    points = np.random.default_rng(1).normal(size=(5000, 3)).astype(np.float32)
    assert np.array_equal(progressive_order(points), progressive_order(points.copy()))


def test_neighbours_on_the_curve_are_neighbours_in_space():
    points = np.random.default_rng(2).random((4000, 3))
    along = points[np.argsort(morton_codes(points))]
    step = np.linalg.norm(np.diff(along, axis=0), axis=1).mean()
    assert step < 0.2 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
