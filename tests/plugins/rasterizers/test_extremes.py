"""Every registered rasterizer at the edges of what it may be asked to draw."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rasterizer_bench import check, every, judge
from splat_scenes import FIELDS, map_fields, random_scene, select, simple_camera

from gavatar_runtime.splatting_rule import NEAR
from gavatar_runtime.values.gaussians import Gaussians, Rendering


def gaussians(means, scales=0.05, colors=(1.0, 0.2, 0.1), **fields) -> Gaussians:
    means = np.atleast_2d(np.asarray(means, np.float64))
    n = len(means)
    return Gaussians(
        means, np.broadcast_to(scales, n).astype(np.float64), np.broadcast_to(colors, (n, 3)) + 0.0, **fields
    )


@pytest.mark.parametrize("size", [(1, 1), (33, 1), (1, 33), (70, 50)])
@every
def test_no_gaussians(target, size):
    nothing = Gaussians(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    got = target.draw(nothing, simple_camera(*size), (0.25, 0.5, -1.5))
    assert got.color.shape == (size[1], size[0], 3)
    assert (got.color == np.float32([0.25, 0.5, -1.5])).all()
    assert not got.alpha.any()
    assert not got.depth.any()


@pytest.mark.parametrize("size", [(1, 1), (2, 1), (17, 16), (70, 50)])
@every
def test_one_gaussian(target, size):
    check(target, gaussians([0.02, 0.01, 2]), simple_camera(*size))


@every
def test_nothing_is_drawn_on_and_behind_the_near_plane(target):
    near = np.float32(NEAR)
    depths = [-2, -NEAR, 0, np.nextafter(near, np.float32(0)), near]
    hidden = gaussians([[0, 0, z] for z in depths])
    assert not target.draw(hidden, simple_camera(20, 20)).alpha.any()
    # the first depth that is drawn; the scale covers the image from there
    front = gaussians([0, 0, np.nextafter(near, np.float32(1))], 1e-3)
    check(target, front, simple_camera(20, 20))


@every
def test_the_border_of_the_image(target):
    """Centres on it, a pixel beyond it, and beyond the frustum margin with a support that reaches in."""
    camera = simple_camera(40, 30)
    edges = [-13.0, -1.0, 0.0, 0.5, 39.5, 40.0, 41.0, 53.0]
    pixels = [(x, y) for x in edges for y in (-10.0, -0.5, 0.0, 15.0, 30.0, 30.5, 40.0)]
    z = np.linspace(1.5, 2.5, len(pixels))
    means = [
        [(x - camera.cx) / camera.fx * d, (y - camera.cy) / camera.fy * d, d]
        for (x, y), d in zip(pixels, z, strict=True)
    ]
    rng = np.random.default_rng(0)
    scene = gaussians(means, rng.uniform(0.005, 0.4, len(means)), rng.random((len(means), 3)))
    scene = dataclasses.replace(scene, opacities=rng.uniform(0.05, 0.7, len(means)))
    check(target, scene, camera)


@pytest.mark.parametrize("center", [(-30.0, 20.0), (20.0, 75.0), (400.0, -300.0)])
@every
def test_a_principal_point_outside_the_image(target, center):
    camera = simple_camera(40, 30, cx=center[0], cy=center[1])
    # pixel coordinates are differences of numbers up to 400, good to 3e-5 pixels, and exponents change by 6 a pixel
    target = dataclasses.replace(target, tolerance=10 * target.tolerance, slack=10 * target.slack)
    scene = random_scene(2, 60, opacity=True)
    depth = scene.means[:, 2]  # brought back into view
    scene.means[:, 0] += depth * (20 - center[0]) / camera.fx
    scene.means[:, 1] += depth * (15 - center[1]) / camera.fy
    check(target, scene, camera)


@every
def test_equal_depths_are_drawn_in_order_of_index(target):
    target.build()
    n, camera = 600, simple_camera(24, 24)
    rng = np.random.default_rng(0)
    means = np.stack([rng.uniform(-0.8, 0.8, n), rng.uniform(-0.8, 0.8, n), np.full(n, 2.0)], 1)
    scene = gaussians(means, 0.3, rng.random((n, 3)), opacities=rng.uniform(0.1, 0.3, n))
    assert target.reference(scene, camera).doubtful.all()  # as long as the ties are taken for near ties
    # the camera leaves z as it is, so they are exact
    judge(target, target.draw(scene, camera), target.reference(scene, camera, depth_slack=0))


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-6, 1.0, 30.0, 1e3])
@every
def test_scales_from_nanometres_to_kilometres(target, scale):
    scene = random_scene(3, 40, opacity=True)
    scene.scales[::2] = scale
    check(target, scene, simple_camera(48, 40))


@pytest.mark.parametrize("axes", [(1e-9, 0.1, 0.1), (1e-9, 1e-9, 0.2), (1.0, 1e-3, 1e-3), (0, 0, 0)])
@every
def test_flat_thin_and_vanishing_ellipsoids(target, axes):
    scene = random_scene(4, 40, isotropic=False)
    scene.scales[:] = axes
    if axes[0] > 100 * axes[2]:
        # along a needle the terms of the exponent reach 1e4 and cancel but for 5.5: measured 1e-4
        target = dataclasses.replace(target, tolerance=100 * target.tolerance, slack=100 * target.slack)
    check(target, scene, simple_camera(48, 40))


@pytest.mark.parametrize("opacity", [0.0, 1 / 256, 1 / 254, 1.0])
@every
def test_opacities_about_the_least_that_is_drawn(target, opacity):
    scene = random_scene(5, 40)
    scene = dataclasses.replace(scene, opacities=np.full(40, opacity))
    check(target, scene, simple_camera(48, 40))


@every
def test_many_on_one_pixel(target):
    target.build()
    count = 1_000_000 if target.fast else 20_000
    same = gaussians(np.tile([0.0, 0.0, 2.0], (count, 1)), 0.01, (0.0, 0.5, 1.0))
    camera = simple_camera(31, 31)
    got = target.draw(same, camera)
    # (1 - 1/255)^k is below the stop for k > 2347: of equal Gaussians, no pixel sees more
    expected = target.reference(select(same, slice(3000)), camera)
    # thousands of factors (1 - alpha) at the rim, each rounded
    judge(dataclasses.replace(target, tolerance=1e-4 + target.tolerance), got, expected)
    assert got.alpha.max() <= 1


@every
def test_a_large_image(target):
    target.build()
    scene = random_scene(6, 150, opacity=True, scale=0.02)
    size = 4096 if target.fast else 1024
    camera = simple_camera(size, size)
    got = target.draw(scene, camera)
    assert got.color.shape == (size, size, 3)
    assert np.isfinite(got.color).all()
    # a float32 coordinate near 4096 is good to 2.4e-4 pixels
    loose = dataclasses.replace(target, tolerance=1e-4 + target.tolerance, slack=1e-2)
    for top, left in ((0, 0), (size // 2 - 100, size // 2), (size - 128, size - 128)):
        expected = target.reference(scene, camera, region=(top, left, 128, 128))
        part = (slice(top, top + 128), slice(left, left + 128))
        judge(loose, Rendering(got.color[part], got.alpha[part], got.depth[part], got.dropped), expected)


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@every
def test_a_bad_value_drops_its_gaussian_and_nothing_else(target, field, value):
    scene, camera = random_scene(7, 40, isotropic=False, opacity=True), simple_camera(40, 30)
    clean = select(scene, np.arange(40) != 17)
    dirty = map_fields(scene, np.copy)
    getattr(dirty, field)[17] = value
    got, expected = target.draw(dirty, camera), target.draw(clean, camera)
    assert got.dropped == 1
    for image in ("color", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(got, image), getattr(expected, image))


@every
def test_bad_isotropic_scales_are_dropped_and_nothing_may_be_left(target):
    scene, camera = random_scene(8, 6), simple_camera(20, 20)
    scene.scales[:] = [np.nan, np.inf, -1, -np.inf, -1e-30, np.nan]
    got = target.draw(scene, camera, (0.1, 0.2, 0.3))
    assert got.dropped == 6
    assert (got.color == np.float32([0.1, 0.2, 0.3])).all()
