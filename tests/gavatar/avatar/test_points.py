"""Points of a body's surface: even in every prefix, as many as asked for, the same every time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gavatar.avatar.atlas import sample_atlas
from gavatar.avatar.blue_noise import CANDIDATES, progressive_order, spread
from gavatar.avatar.on_body import areas
from gavatar.avatar.points import HANDS, HEAD, sample_points, share_of
from gavatar.registry import BODIES, POINTS, load_plugins
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.surface import Atlas

load_plugins()
COUNT = 3000


@pytest.fixture(scope="module")
def body():
    return BODIES.build("free").data


@pytest.fixture(scope="module")
def detailed(body):
    return POINTS.build("detail").sample(body, None, COUNT)


@pytest.mark.parametrize("policy", ["even", "detail"])
def test_every_prefix_is_an_even_sampling(body, policy):
    points = POINTS.build(policy).sample(body, None, COUNT)
    for count in (COUNT, 2100, 1000, 500):
        # 0.11 to 0.15 were measured
        assert spread(points.prefix(count)) < 0.2, count
    rng = np.random.default_rng(0)
    thinned = dataclasses.replace(points, rank=rng.permutation(COUNT).astype(np.int32)).prefix(1000)
    assert spread(thinned) > 0.25
    assert spread(sample_atlas(body, None, 64)) > 0.25  # texels are stretched by the atlas


def test_the_density_is_the_one_that_was_asked_for_in_every_prefix(body, detailed):
    for part, closer in ((HEAD, 2.0), (HANDS, 1.5)):
        inside = share_of(body, part)[body.faces].min(1) == 1  # faces wholly of the part
        trunk = (share_of(body, HEAD) + share_of(body, HANDS))[body.faces].max(1) == 0
        area = areas(body, None)[1]
        for points in (detailed, detailed.prefix(1500)):
            per_area = [np.isin(points.face, np.flatnonzero(f)).sum() / area[f].sum() for f in (inside, trunk)]
            # thin fingers keep points on both their sides, and rims of the few points of a part count
            assert per_area[0] / per_area[1] == pytest.approx(closer**2, rel=0.2)


@pytest.mark.parametrize("count", [1, 2, 7, 100])
def test_any_number_of_points_is_given(body, count):
    for name in POINTS.names():
        surface = POINTS.build(name).sample(body, None, count)
        assert len(surface) == count
        assert sorted(surface.rank) == list(range(count))
        assert np.all(np.isfinite(surface.points))
        assert np.all(surface.spacing > 0)


def test_a_point_stands_for_its_share_of_the_body(body, detailed):
    whole = areas(body, None)[1].sum()
    # fingers keep a little more than their share, so their points stand for a little too much
    assert np.square(detailed.spacing, dtype=float).sum() == pytest.approx(whole, rel=0.05)
    assert np.square(detailed.prefix(700).spacing, dtype=float).sum() == pytest.approx(whole, rel=0.1)


def test_points_of_another_part_do_not_push_points_away():
    """Two sheets a tenth of the spacing apart, their outsides outwards, as an arm lies beside the trunk: each has as
    many points as if it were alone."""
    rng = np.random.default_rng(0)
    count = 200
    plane = rng.random((CANDIDATES * 2 * count, 2))
    side = rng.random(len(plane)) < 0.5
    spacing = np.full(len(plane), np.sqrt(2 / (2 * count)))
    places = np.column_stack([plane, side * 0.1 * spacing[0]])
    outward = np.column_stack([0 * plane, np.where(side, 1.0, -1.0)])
    order = progressive_order(places, outward, spacing, 2 * count)
    assert side[order].sum() == pytest.approx(count, abs=0.1 * count)
    together = progressive_order(places, np.abs(outward), spacing, 2 * count)  # one sheet, for comparison
    nearest = [cKDTree(places[o]).query(places[o], k=2)[0][:, 1].min() for o in (order, together)]
    assert nearest[0] < 0.3 * spacing[0] < nearest[1]


def test_points_are_the_same_every_time_and_stay_where_they_are_when_the_shape_changes(body, detailed, tmp_path):
    again = POINTS.build("detail").sample(body, None, COUNT)
    shaped = POINTS.build("detail").sample(body, np.array([2.0, -1.0]), COUNT)
    for other in (again, shaped):
        np.testing.assert_array_equal(other.face, detailed.face)
        np.testing.assert_array_equal(other.rank, detailed.rank)
    assert np.abs(shaped.points - detailed.points).max() > 0.01
    area = areas(body, np.array([2.0, -1.0]))[1].sum()
    assert np.square(shaped.spacing, dtype=float).sum() == pytest.approx(area, rel=0.05)
    fresh = sample_points(body, None, 50, cache_dir=tmp_path)
    assert [path.name.rpartition("-")[0] for path in tmp_path.iterdir()] == ["points-50"]
    np.testing.assert_array_equal(fresh.points, sample_points(body, None, 50, cache_dir=tmp_path).points)


def test_the_atlas_is_given_for_the_number_of_its_texels(body):
    for side in (64, 100):
        atlas = sample_atlas(body, None, side)
        same = POINTS.build("atlas").sample(body, None, len(atlas))
        assert isinstance(same, Atlas)
        assert same.resolution == side
        np.testing.assert_array_equal(same.texel, atlas.texel)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"count": 0}, "number of points 0 is not possible: choose a whole number from 1 to 1,000,000"),
        ({"count": 1_000_001}, "not possible"),
        ({"count": 2.5}, "not possible"),
        ({"count": 5, "betas": np.array([np.nan])}, "betas hold NaN"),
        ({"count": 5, "density": np.ones(3)}, "density of points must be"),
        ({"count": 5, "density": "negative"}, "density of points must be"),
        ({"count": 5, "density": "nothing"}, "density of points must be"),
    ],
)
def test_what_cannot_be_sampled_is_refused(body, given, message):
    made = {"negative": -np.ones(len(body.v_template)), "nothing": np.zeros(len(body.v_template))}
    values = {"betas": None} | {k: made.get(v, v) if isinstance(v, str) else v for k, v in given.items()}
    with pytest.raises(UserError, match=message):
        sample_points(body, **values)


def test_no_point_lies_where_the_density_is_zero(body):
    head = share_of(body, HEAD)
    points = sample_points(body, None, 300, head)
    assert np.all(head[body.faces[points.face]].max(1) > 0)


@pytest.mark.parametrize("name", ["head", "hands"])
def test_a_density_out_of_range_is_refused(name):
    with pytest.raises(UserError, match=rf"points\.{name} must be within 0\.1 and 10, not 0"):
        POINTS.build("detail", {name: 0})
