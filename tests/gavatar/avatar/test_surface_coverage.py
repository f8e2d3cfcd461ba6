"""Which texels of the UV atlas carry a sample, and what cannot be sampled."""

from __future__ import annotations

import numpy as np
import pytest
from surfaces import FLOAT32_METRES, atlas_place, free_surface, patch_body

from gavatar.avatar.atlas import sample_atlas
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.errors import UserError

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.mark.parametrize("resolution", [64, 128, 256, 512])
def test_spacing_squared_sums_to_the_body_s_area(resolution):
    trimesh = pytest.importorskip("trimesh")
    body, surface = load_free_body(), free_surface(resolution)
    vertices, _ = body.posed(body.canonical_pose())
    area = trimesh.Trimesh(vertices, body.faces, process=False).area
    within = surface.barycentric.min(1) > 0
    # texel centres are a quadrature of the charts: its error is about that of counting texels along 9 m of rim
    np.testing.assert_allclose(np.sum(surface.spacing[within].astype(float) ** 2), area, rtol=0.005)
    # texels on the rim stand for a part of a texel but are given a whole one: at most the rim's length times a texel
    excess = np.sum(surface.spacing.astype(float) ** 2) / area - 1
    assert 0 < excess < 0.25 * 64 / resolution


@pytest.mark.parametrize("resolution", [64, 128, 256])
def test_no_place_of_the_atlas_is_far_from_a_sample(resolution):
    """So the surface closes across seams: both charts of a seam are sampled up to the seam."""
    spatial = pytest.importorskip("scipy.spatial")
    body, surface = load_free_body(), free_surface(resolution)
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(body.faces), 40_000)
    place = np.einsum("nc,ncd->nd", rng.dirichlet([0.5] * 3, len(face)), body.uv[body.uv_faces[face]])
    place = np.stack([place[:, 0], 1 - place[:, 1]], -1) * resolution
    distance, _ = spatial.cKDTree(atlas_place(surface, body)).query(place)
    assert distance.max() < np.sqrt(2)  # the diagonal of a texel


def test_both_sides_of_every_seam_have_samples_nearer_than_without_the_rim():
    spatial = pytest.importorskip("scipy.spatial")
    body, surface = load_free_body(), free_surface(128)
    edges = np.sort(body.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1)
    uv_edges = np.sort(body.uv_faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1)
    pairs = np.unique(np.concatenate([edges, uv_edges], 1), axis=0)
    seams, count = np.unique(pairs[:, :2], axis=0, return_counts=True)
    vertices, _ = body.posed(body.canonical_pose())
    on_seam = vertices[seams[count > 1]].mean(1)
    assert len(on_seam) > 1000
    within = surface.barycentric.min(1) > 0
    with_rim = spatial.cKDTree(surface.points).query(on_seam)[0]
    without = spatial.cKDTree(surface.points[within]).query(on_seam)[0]
    # measured: median 2.9 mm against 6.7 mm, at a median spacing of 12.9 mm
    assert np.median(with_rim) < 0.6 * np.median(without)
    assert np.percentile(with_rim, 99) < np.median(surface.spacing)


def test_one_triangle_covers_the_texels_that_it_touches():
    surface = sample_atlas(patch_body([[0, 0], [1, 0], [0, 1]]), None, 64)
    row, col = np.divmod(surface.texel, 64)
    below = col <= row  # the diagonal u + v = 1 runs from the top left to the bottom right
    beside = col == row + 1  # these touch the triangle in a corner of their square alone
    assert np.all(below | beside)
    assert np.count_nonzero(below) == 64 * 65 // 2
    np.testing.assert_allclose(surface.points[below, :2] * [1, -1] + [0, 1], surface.uv[below], atol=FLOAT32_METRES)
    np.testing.assert_allclose(surface.spacing, 1 / 64, rtol=1e-6)  # the triangle is as large in space as in the atlas
    np.testing.assert_allclose(surface.normals, [[0, 0, 1]] * len(surface), atol=1e-7)


def test_spacing_follows_the_ratio_of_area_in_space_to_area_in_the_atlas():
    uv = np.array([[0.1, 0.1], [0.7, 0.2], [0.3, 0.9]])
    surface = sample_atlas(patch_body(uv, vertices=np.pad(uv * [3, 12], ((0, 0), (0, 1)))), None, 100)
    np.testing.assert_allclose(surface.spacing, 6 / 100, rtol=1e-5)  # sqrt(3 x 12) m a unit of uv; uv is float32


def test_winding_in_the_atlas_does_not_matter():
    uv = [[0.1, 0.1], [0.8, 0.2], [0.3, 0.9]]
    one, other = (sample_atlas(patch_body(uv, faces=[face]), None, 64) for face in ((0, 1, 2), (0, 2, 1)))
    assert np.array_equal(one.texel, other.texel)
    np.testing.assert_allclose(one.points, other.points, atol=FLOAT32_METRES)


def test_where_triangles_overlap_the_lowest_face_wins():
    square = [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]]
    surface = sample_atlas(patch_body(square, faces=[(0, 1, 2), (1, 2, 3), (0, 1, 2)]), None, 64)
    assert set(surface.face) == {0, 1}
    alone = sample_atlas(patch_body(square, faces=[(0, 1, 2)]), None, 64)
    inside = alone.texel[alone.barycentric.min(1) > 0]
    assert np.all(surface.face[np.isin(surface.texel, inside)] == 0)


def test_two_triangles_leave_no_gap_along_their_edge():
    square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    surface = sample_atlas(patch_body(square, faces=[(0, 1, 2), (0, 2, 3)]), None, 65)
    assert len(surface) == 65 * 65
    assert np.all(np.bincount(surface.face) > 65 * 64 // 2 - 1)


@pytest.mark.parametrize("flat", [[[0.2, 0.2], [0.8, 0.8], [0.5, 0.5]], [[0.5, 0.5]] * 3, [[np.nan, 0.1]] * 3])
def test_a_degenerate_uv_triangle_carries_no_texel(flat):
    uv = [*flat, [0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]
    vertices = np.random.default_rng(0).normal(size=(6, 3))
    surface = sample_atlas(patch_body(uv, faces=[(0, 1, 2), (3, 4, 5)], vertices=vertices), None, 64)
    assert set(surface.face) == {1}
    assert np.all(np.isfinite(surface.spacing))


def test_a_face_without_area_in_space_carries_no_texel():
    uv = [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]]
    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0.5, 0.5, 0]]
    surface = sample_atlas(patch_body(uv, faces=[(0, 2, 3), (0, 1, 2)], vertices=vertices), None, 64)
    assert set(surface.face) == {1}


def test_parts_of_the_atlas_outside_the_unit_square_are_left_out():
    surface = sample_atlas(patch_body([[-5, -5], [6, -5], [0.5, 6]]), None, 64)
    assert len(surface) == 64 * 64


def test_an_empty_atlas_is_the_user_s_error():
    with pytest.raises(UserError, match="body 'patch': its UV atlas covers no texel"):
        sample_atlas(patch_body([[0.5, 0.5]] * 3), None, 64)
    with pytest.raises(UserError, match="covers no texel"):
        sample_atlas(patch_body([[0, 0], [1, 0], [0, 1]], faces=np.zeros((0, 3), int)), None, 64)
    with pytest.raises(UserError, match="covers no texel"):  # all of it beside the unit square
        sample_atlas(patch_body([[2, 2], [3, 2], [2, 3]]), None, 64)


@pytest.mark.parametrize("resolution", [0, -64, 63, 1025, 128.0, "128", None, True])
def test_a_bad_resolution_is_the_user_s_error(resolution):
    with pytest.raises(UserError, match="whole number from 64 to 1024"):
        sample_atlas(load_free_body(), None, resolution)


def test_a_numpy_integer_is_a_resolution():
    assert sample_atlas(load_free_body(), None, np.int64(64)).resolution == 64


def test_an_unknown_order_names_the_nearest():
    with pytest.raises(UserError, match="did you mean 'morton'"):
        sample_atlas(load_free_body(), None, 64, order="mortn")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_betas_must_be_finite(bad):
    with pytest.raises(UserError, match="betas hold NaN or infinity"):
        sample_atlas(load_free_body(), [0, bad], 64)
