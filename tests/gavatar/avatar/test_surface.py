"""What the body's surface holds when sampled through its UV atlas, and in which order."""

from __future__ import annotations

import numpy as np
import pytest
from surfaces import BETAS, FLOAT32_METRES, atlas_place, free_surface, patch_body

from gavatar.avatar.atlas import sample_atlas
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.values.surface import Surface

pytestmark = pytest.mark.usefixtures("own_cache")


# ---- what a surface holds


@pytest.mark.parametrize("resolution", [64, 65, 100, 128, 512, 1024])
def test_fields_keep_their_shapes_types_and_ranges(resolution):
    surface = free_surface(resolution)
    N, K, J = len(surface), surface.joint_index.shape[1], 52
    assert 0.5 * resolution**2 < N  # the free body's charts cover 61 percent of its atlas
    assert K <= 8
    expected = {
        "texel": ((N,), np.int32), "uv": ((N, 2), np.float32), "face": ((N,), np.int32),
        "barycentric": ((N, 3), np.float32), "points": ((N, 3), np.float32), "normals": ((N, 3), np.float32),
        "joint_index": ((N, K), np.int32), "joint_weight": ((N, K), np.float32), "spacing": ((N,), np.float32),
        "joints": ((J, 3), np.float64), "parents": ((J,), np.int32), "A_canonical": ((J, 4, 4), np.float64),
    }  # fmt: skip
    for name, (shape, dtype) in expected.items():
        array = getattr(surface, name)
        assert (array.shape, array.dtype) == (shape, dtype), name
        assert np.all(np.isfinite(array)), name
    assert len(np.unique(surface.texel)) == N
    assert 0 <= surface.texel.min() <= surface.texel.max() < resolution**2
    assert np.all(surface.spacing > 0)
    assert surface.barycentric.min() >= 0
    np.testing.assert_allclose(surface.barycentric.sum(1), 1, atol=3e-7)  # three float32 roundings of numbers below 1


@pytest.mark.parametrize("resolution", [64, 100, 512])
def test_uv_is_the_texel_centre_with_v_down(resolution):
    surface = free_surface(resolution)
    row, col = np.divmod(surface.texel, resolution)
    np.testing.assert_allclose(surface.uv * resolution, np.stack([col, row], -1) + 0.5, atol=1e-4)  # R * float32 eps


@pytest.mark.parametrize("resolution", [64, 100, 512])
def test_grid_sample_at_uv_reads_the_texel_itself(resolution):
    torch = pytest.importorskip("torch")
    surface = free_surface(resolution)
    image = torch.arange(resolution**2, dtype=torch.float64).reshape(1, 1, resolution, resolution)
    grid = 2 * torch.as_tensor(surface.uv, dtype=torch.float64)[None, None] - 1
    read = torch.nn.functional.grid_sample(image, grid, align_corners=False)[0, 0, 0]
    # a float32 uv is off by up to 3e-8, R times that in texels; a texel's step is R down and 1 across the image, and at
    # the image's edge such a part of the texel is read as zero padding
    off = 3e-8 * resolution
    np.testing.assert_allclose(read.numpy(), surface.texel, rtol=off, atol=off * (resolution + 1))


@pytest.mark.parametrize("betas", [None, tuple(BETAS)])
def test_every_point_is_rebuilt_from_its_face_and_weights(betas):
    trimesh = pytest.importorskip("trimesh")
    body, surface = load_free_body(), free_surface(128, betas)
    vertices, _ = body.posed(body.canonical_pose(), betas)
    corners = vertices[body.faces[surface.face]]
    rebuilt = np.einsum("nc,ncd->nd", surface.barycentric, corners)
    np.testing.assert_allclose(surface.points, rebuilt, atol=FLOAT32_METRES)
    # an opinion that knows nothing of our weights; in millimetres, since its tolerances are absolute
    nearest = trimesh.triangles.closest_point(corners * 1e3, surface.points * 1e3) / 1e3
    np.testing.assert_allclose(surface.points, nearest, atol=FLOAT32_METRES)


@pytest.mark.parametrize("resolution", [64, 100, 512])
def test_samples_lie_at_their_texel_centre_or_on_a_charts_rim_within_the_texel(resolution):
    surface = free_surface(resolution)
    offset = np.abs(atlas_place(surface, load_free_body()) - surface.uv.astype(np.float64) * resolution).max(1)
    on_rim = surface.barycentric.min(1) == 0
    rounding = 1e-4  # float32 weights and centres, times R
    assert np.all(offset[~on_rim] < rounding)
    assert np.all(offset[on_rim] <= 0.5 + rounding)
    assert 0 < on_rim.mean() < 0.15


def test_normals_are_unit_and_those_of_the_mesh():
    trimesh = pytest.importorskip("trimesh")
    body, surface = load_free_body(), free_surface(128)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, atol=3e-7)  # float32 rounding
    vertices, _ = body.posed(body.canonical_pose())
    mesh = trimesh.Trimesh(vertices, body.faces, process=False)
    cosine = np.sum(mesh.face_normals[surface.face] * surface.normals, 1)
    assert np.median(cosine) > 0.99
    assert np.mean(cosine < 0) < 1e-3  # a fold of lip or eyelid, where vertex normals average opposite faces


def test_weights_sum_to_one_in_descending_order_and_unused_entries_are_zero():
    surface = free_surface(128)
    weights = surface.joint_weight
    np.testing.assert_allclose(weights.sum(1), 1, atol=5e-7)  # eight float32 roundings
    assert np.all(np.diff(weights, axis=1) <= 0)
    assert np.all(surface.joint_index[weights == 0] == 0)
    assert np.any(weights[:, -1] > 0), "K is wider than any point needs"
    for index, weight in zip(surface.joint_index[::97], weights[::97], strict=True):
        assert len(np.unique(index[weight > 0])) == np.count_nonzero(weight)


def test_weights_are_the_barycentric_blend_of_the_vertices():
    body, surface = load_free_body(), free_surface(64)
    blend = np.einsum("nc,ncj->nj", surface.barycentric, body.lbs_weights[body.faces[surface.face]])
    dense = np.zeros_like(blend)
    np.add.at(dense, (np.arange(len(surface))[:, None], surface.joint_index), surface.joint_weight)
    assert surface.weight_truncation == 0  # nothing cut: the free body's faces touch few joints
    np.testing.assert_allclose(dense, blend, atol=1e-6)  # float32, and the body's rows sum to 1 within as much


def test_more_joints_than_eight_are_cut_renormalised_and_reported():
    rows = np.tile(np.arange(12, 0, -1, dtype=np.float32) / 78, (3, 1))  # 12/78, 11/78, ... 1/78
    surface = sample_atlas(patch_body([[0, 0], [1, 0], [0, 1]], lbs_weights=rows), None, 64)
    assert surface.joint_weight.shape[1] == 8
    assert np.array_equal(np.unique(surface.joint_index, axis=0), [np.arange(8)])
    np.testing.assert_allclose(surface.weight_truncation, (4 + 3 + 2 + 1) / 78, atol=1e-6)
    np.testing.assert_allclose(surface.joint_weight[0], np.arange(12, 4, -1) / 68, atol=1e-6)


# ---- order


def block_radius(surface: Surface, size: int = 256) -> float:
    """Root mean square distance, metres, of points from the centre of their run of `size` points in memory."""
    blocks = surface.points[: len(surface) // size * size].reshape(-1, size, 3)
    return float(np.sqrt(np.mean(np.sum((blocks - blocks.mean(1, keepdims=True)) ** 2, -1))))


def test_morton_order_is_a_permutation_of_row_order():
    row, morton = free_surface(128, order="row"), free_surface(128)
    assert np.all(np.diff(row.texel) > 0)
    sorting = np.argsort(morton.texel)
    for name, values in row.to_arrays().items():
        # where points coincide, that which is stored first comes first in the progressive order too
        if values.ndim and len(values) == len(row) and name != "rank":
            assert np.array_equal(morton.to_arrays()[name][sorting], values), name


def test_morton_order_keeps_neighbours_together():
    # measured at 512: 0.13 m against 0.49 m; a block of 16 x 16 texels of the atlas is about 0.05 m wide
    assert block_radius(free_surface(512)) < 0.4 * block_radius(free_surface(512, order="row"))


def test_sampling_twice_gives_the_same_bits(tmp_path):
    one = sample_atlas(load_free_body(), BETAS, 100, cache_dir=tmp_path / "a").to_arrays()
    two = sample_atlas(load_free_body(), BETAS, 100, cache_dir=tmp_path / "b").to_arrays()
    assert all(np.array_equal(one[name], two[name]) for name in one)
