"""The sampled surface in a pose: skinned points, positional maps."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from surfaces import BETAS, FLOAT32_METRES, blend_in_float64, free_surface, random_poses

from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.decoding.uv_maps import positional_map

pytestmark = pytest.mark.usefixtures("own_cache")


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
