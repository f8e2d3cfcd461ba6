"""Choosing a level of detail, by a number of Gaussians or by what pixels need."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gavatar_runtime.decoding.detail import (
    FEWEST,
    SHARE,
    SPREAD,
    count_for_footage,
    count_for_side,
    count_for_size,
    first,
    grown,
)
from gavatar_runtime.errors import WrongValue
from gavatar_runtime.values.surface import Surface

pytest.importorskip("onnx", reason="the bundle's surface is made beside networks")
from make_bundle import SCALE, free_body, surface_of

EVERY = 9000


@pytest.fixture(scope="module")
def atlas():
    return surface_of(free_body(), EVERY, 96)


@pytest.fixture(scope="module")
def free(atlas) -> Surface:
    """The same points, of no grid."""
    return Surface.from_arrays({k: v for k, v in atlas.to_arrays().items() if k not in ("texel", "resolution")})


@pytest.mark.parametrize("count", [1, 17, 4200, 8999])
def test_the_first_of_the_order_stand_for_all(free, count):
    chosen, added = first(free, count)
    assert np.array_equal(chosen, np.flatnonzero(free.rank < count))
    assert len(chosen) == count
    # what each gains goes with the area that it stands for more
    np.testing.assert_allclose(added, SPREAD**2 * (EVERY / count - 1) * SCALE**2, rtol=1e-5)
    assert added.dtype == np.float32
    np.testing.assert_allclose(grown(np.float32([0, SCALE]), added[:1])[0], np.sqrt(added[0]), rtol=1e-6)


@pytest.mark.parametrize("count", [EVERY, EVERY + 1, 10**9])
def test_all_where_as_many_or_more_are_asked_for_and_none_grows(free, count):
    chosen, added = first(free, count)
    assert np.array_equal(chosen, np.arange(EVERY))
    assert not added.any()


@pytest.mark.parametrize("count", [0, -5])
def test_none_at_all_are_refused(free, count):
    with pytest.raises(WrongValue, match=f"`gaussians={count}`: give a whole number from 1 up"):
        first(free, count)


def test_pixels_need_one_each_of_the_square_about_the_person(free):
    assert count_for_size(free, 80) == 6400
    assert count_for_size(free, 1) == FEWEST
    assert count_for_size(free, 1e6) == count_for_size(free, np.inf) == EVERY
    assert count_for_size(free.prefix(30), 1) == 30
    tall = float(np.ptp(free.points[:, 1]))
    assert count_for_footage(free, tall / 80) == 6400
    assert count_for_footage(free, None) == EVERY


def test_a_side_of_an_atlas_is_its_texels_on_the_body(atlas, free):
    assert count_for_side(atlas, None, 96) == count_for_side(free, atlas, 96) == EVERY
    assert count_for_side(atlas, None, 48) == EVERY // 4
    assert count_for_side(free, None, 64) == round(SHARE * 64**2)
    assert count_for_side(free, None, 1) == 1
    assert count_for_side(free, None, 10**6) == EVERY
    assert count_for_side(dataclasses.replace(atlas, resolution=192), None, 96) == EVERY // 4
