"""Choosing a level of detail by the number of Gaussians."""

from __future__ import annotations

import pytest

from gavatar_runtime.decoding.detail import MIN_UV, thinned, uv_for_count
from gavatar_runtime.errors import WrongValue

pytest.importorskip("onnx", reason="the bundle's surface is made beside networks")
from make_bundle import free_body, surface_of


@pytest.fixture(scope="module")
def surface():
    return surface_of(free_body(), 9000, 96)


@pytest.mark.parametrize("count", [4200, 5000, 6543, 8999])
def test_the_finest_level_that_keeps_no_more(surface, count):
    uv = uv_for_count(surface, count)
    assert len(thinned(surface, uv)[0]) <= count < len(thinned(surface, uv + 1)[0])


def test_all_where_as_many_or_more_are_asked_for(surface):
    assert uv_for_count(surface, 9000) == uv_for_count(surface, 10**9) == surface.resolution


@pytest.mark.parametrize("count", [0, 1, -5])
def test_fewer_than_the_coarsest_level_keeps_are_refused(surface, count):
    fewest = len(thinned(surface, MIN_UV)[0])
    assert uv_for_count(surface, fewest) >= MIN_UV
    with pytest.raises(WrongValue, match=f"`gaussians={count}`: this avatar has {fewest} to 9000"):
        uv_for_count(surface, count)
