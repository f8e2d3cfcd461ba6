"""Points of the body's surface: picks and prefixes of them, and the order that these follow."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from make_bundle import free_body, surface_of

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.ordering import progressive_rank
from gavatar_runtime.values.surface import Atlas, Surface

COUNT = 300


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    made = surface_of(free_body(), COUNT, 32)
    return dataclasses.replace(made, rank=progressive_rank(made.points))


def free(atlas: Atlas) -> Surface:
    """The same points, of no grid."""
    arrays = {name: value for name, value in atlas.to_arrays().items() if name not in ("resolution", "texel")}
    return Surface.from_arrays(arrays)


def test_a_prefix_is_the_points_of_lowest_rank_as_they_are_stored(atlas):
    part = atlas.prefix(100)
    rows = np.flatnonzero(atlas.rank < 100)
    assert len(part) == 100
    assert np.array_equal(part.points, atlas.points[rows])
    assert np.array_equal(part.texel, atlas.texel[rows])
    assert np.array_equal(part.rank, atlas.rank[rows])
    np.testing.assert_allclose(part.spacing, atlas.spacing[rows] * 3**0.5, rtol=1e-6)


def test_a_prefix_of_a_prefix_is_the_shorter_one(atlas):
    twice, once = atlas.prefix(200).prefix(50).to_arrays(), atlas.prefix(50).to_arrays()
    spacing = twice.pop("spacing"), once.pop("spacing")
    assert all(np.array_equal(twice[name], once[name]) for name in once)
    np.testing.assert_allclose(*spacing, rtol=1e-6)


def test_the_longest_prefix_is_the_surface_itself(atlas):
    assert atlas.prefix(COUNT) is atlas
    assert atlas.prefix(10**9) is atlas
    with pytest.raises(ValueError, match="0 points"):
        atlas.prefix(0)


def test_picked_points_keep_their_order(atlas):
    rows = np.array([250, 3, 77, 4])
    part = atlas.take(rows)
    assert np.array_equal(np.argsort(part.rank), np.argsort(atlas.rank[rows]))
    assert np.array_equal(np.sort(part.rank), np.arange(4))
    assert np.array_equal(part.points, atlas.points[rows])


def test_points_of_no_grid_come_back_as_what_they_were(atlas):
    surface = free(atlas)
    assert type(surface) is Surface
    assert type(Surface.from_arrays(atlas.to_arrays())) is Atlas
    assert type(surface.prefix(10)) is type(surface.take(np.arange(3))) is Surface
    assert len(surface) == COUNT


def test_points_without_an_order_are_given_one(atlas):
    arrays = {name: value for name, value in atlas.to_arrays().items() if name != "rank"}
    assert np.array_equal(Surface.from_arrays(arrays).rank, progressive_rank(atlas.points))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"rank": np.zeros(COUNT, np.int32)}, "'rank' is no order of 300 things"),
        ({"rank": np.arange(1, COUNT + 1)}, "'rank' points outside 0 to 299"),
        ({"rank": np.arange(COUNT - 1)}, r"'rank' has shape \(299,\)"),
        ({"rank": np.arange(COUNT) + 0.5}, "'rank' holds float64, expected whole numbers"),
        ({"resolution": None}, "lacks the array 'resolution'"),
    ],
)
def test_what_is_no_surface_is_refused(atlas, change, what):
    arrays = {name: value for name, value in (atlas.to_arrays() | change).items() if value is not None}
    with pytest.raises(UserError, match=what):
        Surface.from_arrays(arrays, "a.npz")
