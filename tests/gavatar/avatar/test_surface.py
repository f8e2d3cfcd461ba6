"""The body's surface sampled through its UV atlas."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from gavatar.avatar import points as surface_module
from gavatar.avatar.points import default_cache_dir, sample_surface
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.decoding.uv_maps import positional_map
from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.surface_file import load_surface, save_surface
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Surface

# float32 holds a coordinate of 2 m to 1.2e-7; a few roundings of such coordinates are summed
FLOAT32_METRES = 2e-6
BETAS = np.array([1.0, -0.5, 0.3, 0, 0, 0, 0, 0, 0, 2.0])


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch):
    """Tests share one temporary cache and never touch the user's."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@functools.cache
def free_surface(resolution: int, betas: tuple | None = None, order: str = "morton") -> Surface:
    return sample_surface(load_free_body(), betas, resolution, order=order)


def patch_body(uv, faces=((0, 1, 2),), vertices=None, uv_faces=None, lbs_weights=None) -> BodyData:
    """A body of three joints in a row whose skin is a few triangles; by default in space they are as in the atlas."""
    uv = np.asarray(uv, np.float32)
    vertices = np.pad(uv, ((0, 0), (0, 1))) if vertices is None else np.asarray(vertices, np.float32)
    if lbs_weights is None:
        lbs_weights = np.tile(np.float32([1, 0, 0]), (len(vertices), 1))
    J = lbs_weights.shape[1]
    return BodyData(
        name="patch",
        v_template=vertices,
        shapedirs=np.zeros((len(vertices), 3, 1), np.float32),
        J_regressor=np.full((J, len(vertices)), 1 / len(vertices), np.float32),
        parents=np.arange(-1, J - 1, dtype=np.int32),
        lbs_weights=lbs_weights,
        faces=np.asarray(faces, np.int32),
        uv=uv,
        uv_faces=np.asarray(faces if uv_faces is None else uv_faces, np.int32),
        joint_names=("pelvis", "left_hip", "right_hip", *(f"joint{j}" for j in range(3, J)))[:J],
    )


def random_poses(count: int, scale: float = 0.5) -> np.ndarray:
    return np.random.default_rng(7).normal(0, scale, (count, load_free_body().num_joints, 3))


def blend_in_float64(surface: Surface, poses: np.ndarray) -> np.ndarray:
    """(N, 3) linear blend skinning of the canonical points, written out densely with a general matrix inverse."""
    body = load_free_body()
    transforms = body.skinning(poses) @ np.linalg.inv(body.skinning(body.canonical_pose()))
    weights = np.zeros((len(surface), body.num_joints))
    np.add.at(weights, (np.arange(len(surface))[:, None], surface.joint_index), surface.joint_weight)
    homogeneous = np.pad(surface.points.astype(np.float64), ((0, 0), (0, 1)), constant_values=1)
    return np.einsum("nj,jab,nb->na", weights, transforms, homogeneous)[:, :3]


def atlas_place(surface: Surface, body: BodyData) -> np.ndarray:
    """(N, 2) where face and barycentric weights lie in the atlas, as (x, y) in texels, y down."""
    corners = body.uv.astype(np.float64)[body.uv_faces[surface.face]]
    uv = np.einsum("nc,ncd->nd", surface.barycentric.astype(np.float64), corners)
    return np.stack([uv[:, 0], 1 - uv[:, 1]], -1) * surface.resolution


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
    surface = sample_surface(patch_body([[0, 0], [1, 0], [0, 1]], lbs_weights=rows), None, 64)
    assert surface.joint_weight.shape[1] == 8
    assert np.array_equal(np.unique(surface.joint_index, axis=0), [np.arange(8)])
    np.testing.assert_allclose(surface.weight_truncation, (4 + 3 + 2 + 1) / 78, atol=1e-6)
    np.testing.assert_allclose(surface.joint_weight[0], np.arange(12, 4, -1) / 68, atol=1e-6)


# ---- coverage


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
    surface = sample_surface(patch_body([[0, 0], [1, 0], [0, 1]]), None, 64)
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
    surface = sample_surface(patch_body(uv, vertices=np.pad(uv * [3, 12], ((0, 0), (0, 1)))), None, 100)
    np.testing.assert_allclose(surface.spacing, 6 / 100, rtol=1e-5)  # sqrt(3 x 12) m a unit of uv; uv is float32


def test_winding_in_the_atlas_does_not_matter():
    uv = [[0.1, 0.1], [0.8, 0.2], [0.3, 0.9]]
    one, other = (sample_surface(patch_body(uv, faces=[face]), None, 64) for face in ((0, 1, 2), (0, 2, 1)))
    assert np.array_equal(one.texel, other.texel)
    np.testing.assert_allclose(one.points, other.points, atol=FLOAT32_METRES)


def test_where_triangles_overlap_the_lowest_face_wins():
    square = [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]]
    surface = sample_surface(patch_body(square, faces=[(0, 1, 2), (1, 2, 3), (0, 1, 2)]), None, 64)
    assert set(surface.face) == {0, 1}
    alone = sample_surface(patch_body(square, faces=[(0, 1, 2)]), None, 64)
    inside = alone.texel[alone.barycentric.min(1) > 0]
    assert np.all(surface.face[np.isin(surface.texel, inside)] == 0)


def test_two_triangles_leave_no_gap_along_their_edge():
    square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    surface = sample_surface(patch_body(square, faces=[(0, 1, 2), (0, 2, 3)]), None, 65)
    assert len(surface) == 65 * 65
    assert np.all(np.bincount(surface.face) > 65 * 64 // 2 - 1)


@pytest.mark.parametrize("flat", [[[0.2, 0.2], [0.8, 0.8], [0.5, 0.5]], [[0.5, 0.5]] * 3, [[np.nan, 0.1]] * 3])
def test_a_degenerate_uv_triangle_carries_no_texel(flat):
    uv = [*flat, [0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]
    vertices = np.random.default_rng(0).normal(size=(6, 3))
    surface = sample_surface(patch_body(uv, faces=[(0, 1, 2), (3, 4, 5)], vertices=vertices), None, 64)
    assert set(surface.face) == {1}
    assert np.all(np.isfinite(surface.spacing))


def test_a_face_without_area_in_space_carries_no_texel():
    uv = [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]]
    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0.5, 0.5, 0]]
    surface = sample_surface(patch_body(uv, faces=[(0, 2, 3), (0, 1, 2)], vertices=vertices), None, 64)
    assert set(surface.face) == {1}


def test_parts_of_the_atlas_outside_the_unit_square_are_left_out():
    surface = sample_surface(patch_body([[-5, -5], [6, -5], [0.5, 6]]), None, 64)
    assert len(surface) == 64 * 64


def test_an_empty_atlas_is_the_user_s_error():
    with pytest.raises(UserError, match="body 'patch': its UV atlas covers no texel"):
        sample_surface(patch_body([[0.5, 0.5]] * 3), None, 64)
    with pytest.raises(UserError, match="covers no texel"):
        sample_surface(patch_body([[0, 0], [1, 0], [0, 1]], faces=np.zeros((0, 3), int)), None, 64)
    with pytest.raises(UserError, match="covers no texel"):  # all of it beside the unit square
        sample_surface(patch_body([[2, 2], [3, 2], [2, 3]]), None, 64)


@pytest.mark.parametrize("resolution", [0, -64, 63, 1025, 128.0, "128", None, True])
def test_a_bad_resolution_is_the_user_s_error(resolution):
    with pytest.raises(UserError, match="whole number from 64 to 1024"):
        sample_surface(load_free_body(), None, resolution)


def test_a_numpy_integer_is_a_resolution():
    assert sample_surface(load_free_body(), None, np.int64(64)).resolution == 64


def test_an_unknown_order_names_the_nearest():
    with pytest.raises(UserError, match="did you mean 'morton'"):
        sample_surface(load_free_body(), None, 64, order="mortn")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_betas_must_be_finite(bad):
    with pytest.raises(UserError, match="betas hold NaN or infinity"):
        sample_surface(load_free_body(), [0, bad], 64)


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
        if values.ndim and len(values) == len(row):
            assert np.array_equal(morton.to_arrays()[name][sorting], values), name


def test_morton_order_keeps_neighbours_together():
    # measured at 512: 0.13 m against 0.49 m; a block of 16 x 16 texels of the atlas is about 0.05 m wide
    assert block_radius(free_surface(512)) < 0.4 * block_radius(free_surface(512, order="row"))


def test_sampling_twice_gives_the_same_bits(tmp_path):
    one = sample_surface(load_free_body(), BETAS, 100, cache_dir=tmp_path / "a").to_arrays()
    two = sample_surface(load_free_body(), BETAS, 100, cache_dir=tmp_path / "b").to_arrays()
    assert all(np.array_equal(one[name], two[name]) for name in one)


# ---- poses


def test_the_canonical_pose_moves_no_point():
    surface = free_surface(128)
    canonical = load_free_body().canonical_pose()
    np.testing.assert_allclose(surface.skin_transforms(canonical), np.tile(np.eye(4), (52, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(surface.posed(canonical), surface.points, atol=FLOAT32_METRES)


def test_the_zero_pose_is_the_rest_shape_away_from_the_hips():
    body, surface = load_free_body(), free_surface(128, tuple(BETAS))
    vertices, _ = body.shaped(BETAS)
    rest = np.einsum("nc,ncd->nd", surface.barycentric, vertices[body.faces[surface.face]])
    off = np.linalg.norm(surface.posed(np.zeros((52, 3))) - rest, axis=1)
    # where joints that the canonical pose turns differently blend, undoing each joint is not undoing their blend:
    # 15 mm at most, at the hips; elsewhere it is exact
    pelvis, hips = 0, [body.joint_names.index(name) for name in ("left_hip", "right_hip")]
    legs = np.isin(surface.joint_index, hips) & (surface.joint_weight > 0)
    assert np.all(off[~legs.any(1)] < 3 * FLOAT32_METRES)
    assert off.max() < 0.02
    assert np.any(surface.joint_index[off > 0.01] == pelvis)


@pytest.mark.parametrize("scale", [0.0, 0.3, 1.5])
def test_posed_points_agree_with_dense_skinning_in_float64(scale):
    surface = free_surface(100, tuple(0 * BETAS))
    for poses in random_poses(3, scale):
        # float32 poses and transforms: 6e-8 relative, over chains of joints that reach 2 m
        np.testing.assert_allclose(surface.posed(poses), blend_in_float64(surface, poses), atol=5e-6)


def test_a_positional_map_holds_the_skinned_points_relative_to_the_root():
    surface = free_surface(100)
    for poses in random_poses(3):
        upright = np.where(np.arange(52)[:, None] == 0, 0, poses)
        image = positional_map(surface, poses)
        assert image.shape == (100, 100, 3)
        assert image.dtype == np.float32
        held = image.reshape(-1, 3)[surface.texel]
        np.testing.assert_allclose(held, blend_in_float64(surface, upright) - surface.joints[0], atol=5e-6)
        invalid = np.setdiff1d(np.arange(100**2), surface.texel)
        assert np.all(image.reshape(-1, 3)[invalid] == 0)


def test_a_positional_map_is_upright_and_near_the_mesh():
    """The map of the zero pose has the head's texels above and the feet's below: rows, axes and signs are right."""
    body, surface = load_free_body(), free_surface(64)
    image = positional_map(surface, np.zeros((52, 3)))
    height = image.reshape(-1, 3)[surface.texel, 1]
    top = body.lbs_weights[body.faces[surface.face]].sum(1).argmax(1)
    assert height[top == body.joint_names.index("head")].min() > 0.4
    assert height[top == body.joint_names.index("left_foot")].max() < -0.7


@pytest.mark.parametrize("root", [[np.pi, 0, 0], [0, -np.pi, 0], [0, 2 * np.pi, 0], [0.3, 4.0, -1.0], [np.nan, 0, 0]])
def test_the_root_s_rotation_does_not_touch_the_map(root):
    surface = free_surface(64)
    poses = random_poses(1)[0]
    turned = poses.copy()
    turned[0] = root
    assert np.array_equal(positional_map(surface, poses), positional_map(surface, turned))


@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi - 1e-7, np.pi, np.pi + 1e-7, 2 * np.pi])
def test_maps_and_transforms_are_finite_and_right_at_zero_and_pi(angle):
    surface = free_surface(64)
    poses = np.zeros((52, 3))
    poses[1:, 1] = angle
    A = surface.skin_transforms(poses)
    assert np.all(np.isfinite(A))
    np.testing.assert_allclose(
        A[:, :3, :3] @ np.swapaxes(A[:, :3, :3], 1, 2), np.tile(np.eye(3), (52, 1, 1)), atol=1e-12
    )
    image = positional_map(surface, poses).reshape(-1, 3)[surface.texel]
    # float32 angles near pi are off by 1e-7, adding up along chains of 9 joints and 2 m
    np.testing.assert_allclose(image, blend_in_float64(surface, poses) - surface.joints[0], atol=1e-5)


def test_a_batch_is_its_frames_and_may_be_empty():
    surface = free_surface(64)
    poses = random_poses(6)
    single = np.stack([positional_map(surface, pose) for pose in poses])
    assert np.array_equal(positional_map(surface, poses), single)
    assert np.array_equal(positional_map(surface, poses.reshape(2, 3, 52, 3)), single.reshape(2, 3, 64, 64, 3))
    assert positional_map(surface, poses[:0]).shape == (0, 64, 64, 3)
    assert surface.skin_transforms(poses[:0]).shape == (0, 52, 4, 4)


def test_transforms_keep_the_dtype_of_the_poses():
    surface = free_surface(64)
    for dtype in (np.float32, np.float64):
        assert surface.skin_transforms(np.zeros((52, 3), dtype)).dtype == dtype
    assert surface.skin_transforms(np.zeros((52, 3), int)).dtype == np.float32


def test_poses_are_not_written_to():
    poses = np.full((52, 3), 0.1, np.float32)
    positional_map(free_surface(64), poses)
    assert np.all(poses == np.float32(0.1))


@pytest.mark.parametrize("shape", [(24, 3), (52, 4), (156,)])
def test_poses_of_another_skeleton_are_refused(shape):
    for call in (free_surface(64).skin_transforms, functools.partial(positional_map, free_surface(64))):
        with pytest.raises(ValueError, match=r"expected \(\.\.\., 52, 3\)"):
            call(np.zeros(shape))


# ---- files


def same(a: Surface, b: Surface) -> bool:
    one, two = a.to_arrays(), b.to_arrays()
    return all(np.array_equal(one[name], two[name]) and one[name].dtype == two[name].dtype for name in one)


def test_a_surface_survives_a_file_unchanged(tmp_path):
    surface = free_surface(64)
    save_surface(tmp_path / "surface.npz", surface)
    loaded = load_surface(tmp_path / "surface.npz")
    assert same(loaded, surface)
    assert isinstance(loaded.resolution, int)
    assert isinstance(loaded.weight_truncation, float)
    assert [path.name for path in tmp_path.iterdir()] == ["surface.npz"]


def test_arrays_that_do_not_make_a_surface_are_named():
    arrays = free_surface(64).to_arrays()
    assert not any(array.dtype.hasobject for array in arrays.values())
    with pytest.raises(UserError, match=r"avatar\.npz: array 'uv' is missing"):
        Surface.from_arrays({name: value for name, value in arrays.items() if name != "uv"}, "avatar.npz")
    with pytest.raises(UserError, match="'points' has shape"):
        Surface.from_arrays({**arrays, "points": arrays["points"][:-1]})
    with pytest.raises(UserError, match="'joint_index' points outside 0 to 51"):
        Surface.from_arrays({**arrays, "joint_index": arrays["joint_index"] + 52})
    with pytest.raises(UserError, match="'texel' points outside 0 to 4095"):
        Surface.from_arrays({**arrays, "texel": arrays["texel"] - 4096})


def test_unreadable_files_are_the_user_s_error(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        load_surface(tmp_path / "absent.npz")
    np.savez(tmp_path / "pickle.npz", **{**free_surface(64).to_arrays(), "uv": np.array([{}], object)})
    np.save(tmp_path / "other.npy", np.zeros(3))
    (tmp_path / "text.npz").write_text("not an archive")
    (tmp_path / "empty.npz").touch()
    (tmp_path / "folder.npz").mkdir()
    for name in ("pickle.npz", "other.npy", "text.npz", "empty.npz", "folder.npz"):
        with pytest.raises(UserError, match=rf"{name}: not a readable surface"):
            load_surface(tmp_path / name)


# ---- cache


def test_the_second_call_reads_the_cache(tmp_path, monkeypatch):
    first = sample_surface(load_free_body(), BETAS, 64, cache_dir=tmp_path)
    monkeypatch.setattr(surface_module, "_sample", lambda *_: pytest.fail("computed again"))
    assert same(sample_surface(load_free_body(), BETAS, 64, cache_dir=tmp_path), first)


def test_whatever_changes_the_surface_changes_its_place_in_the_cache(tmp_path):
    body = load_free_body()
    moved = dataclasses.replace(body, v_template=body.v_template + np.float32(1e-3))
    renamed = dataclasses.replace(body, joint_names=("root", *body.joint_names[1:]))
    mirrored = dataclasses.replace(body, uv=body.uv * [-1, 1] + [1, 0])
    variants = [(body, None, 64), (body, BETAS, 64), (body, None, 65), (moved, None, 64), (renamed, None, 64)]
    for number, variant in enumerate([*variants, (mirrored, None, 64)], 1):
        sample_surface(*variant, cache_dir=tmp_path)
        assert len(list(tmp_path.iterdir())) == number
    sample_surface(body, None, 64, order="row", cache_dir=tmp_path)
    assert len(list(tmp_path.iterdir())) == 7


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "text", "another archive"])
def test_a_damaged_cache_is_rebuilt_in_silence(tmp_path, damage, recwarn):
    first = sample_surface(load_free_body(), None, 64, cache_dir=tmp_path)
    (path,) = tmp_path.iterdir()
    data = path.read_bytes()
    if damage == "another archive":
        np.savez(path, texel=np.zeros(3))
    else:
        middle = len(data) // 2
        flipped = data[:middle] + bytes([data[middle] ^ 255]) + data[middle + 1 :]
        path.write_bytes({"truncated": data[:middle], "flipped": flipped, "empty": b"", "text": b"hello"}[damage])
    assert same(sample_surface(load_free_body(), None, 64, cache_dir=tmp_path), first)
    assert same(load_surface(path), first)
    assert not recwarn.list


def test_an_unusable_cache_folder_only_costs_time(tmp_path):
    (tmp_path / "file").touch()
    assert len(sample_surface(load_free_body(), None, 64, cache_dir=tmp_path / "file" / "below")) > 0


def test_the_default_cache_honours_xdg(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    sample_surface(load_free_body(), None, 64)
    assert len(list((tmp_path / "gavatar" / "surfaces").iterdir())) == 1
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for value in ("", "relative/path"):
        monkeypatch.setenv("XDG_CACHE_HOME", value)
        assert default_cache_dir() == tmp_path / "home" / ".cache" / "gavatar" / "surfaces"
