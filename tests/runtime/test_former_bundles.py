"""Bundles of format 1, whose Gaussians are the texels of an atlas, play as they did."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import pack_arrays, read_bundle, write_bundle
from gavatar_runtime.formats.bounded import arrays_of_npz
from gavatar_runtime.geometry.ordering import progressive_rank
from gavatar_runtime.values.surface import Atlas

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import free_body, manifest, members, surface_of

COUNT, SIDE = 400, 32


@pytest.fixture(scope="module")
def grid() -> Atlas:
    """Points whose texels are neighbours where they are neighbours on a plane, a centimetre apart."""
    made = surface_of(free_body(), COUNT, SIDE)
    row, column = np.divmod(np.arange(COUNT), 20)
    points = np.stack([0.01 * column, 1 - 0.01 * row, np.zeros(COUNT)], 1).astype(np.float32)
    return dataclasses.replace(made, points=points, texel=(row * SIDE + column).astype(np.int32))


def former(path, grid):
    """A bundle as format 1 stored it."""
    made = members(COUNT, dynamic=True)
    arrays = arrays_of_npz(made["surface.npz"])
    for name in ("uv", "rank", "spacing"):
        del arrays[f"gaussians_{name}"]
    arrays |= {"gaussians_texel": grid.texel, "gaussians_resolution": np.array(SIDE), "gaussians_points": grid.points}
    write_bundle(path, manifest(COUNT, dynamic=True), made | {"surface.npz": pack_arrays(arrays)})
    return read_bundle(path)


def test_its_points_have_the_order_and_the_spacing_that_follow_from_the_texels(tmp_path, grid):
    surface, encoder_map = former(tmp_path / "a.gavatar", grid).surfaces()
    assert isinstance(surface, Atlas)
    assert surface.resolution == SIDE
    assert np.array_equal(surface.texel, grid.texel)
    assert np.array_equal(surface.rank, progressive_rank(grid.points))
    np.testing.assert_allclose(surface.spacing, 0.01, rtol=1e-4)
    assert isinstance(encoder_map, Atlas)


def test_it_plays_whole_and_at_a_level_of_detail(tmp_path, grid):
    bundle = former(tmp_path / "a.gavatar", grid)
    pose = np.full((52, 3), 0.1, np.float32)
    every, some = (Avatar(bundle, gaussians=count).gaussians(pose) for count in (None, 100))
    rows = np.flatnonzero(bundle.surfaces()[0].rank < 100)
    np.testing.assert_array_equal(some.means, every.means[rows])
    np.testing.assert_array_equal(some.colors, every.colors[rows])
    assert (some.scales > every.scales[rows]).all()
