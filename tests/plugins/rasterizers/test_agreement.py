"""Every registered rasterizer draws what the float64 reference draws."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
import reference_splat
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterizer_bench import Target, check, every, judge
from splat_scenes import body_camera, body_scene, random_scene, simple_camera

from gavatar_runtime.values.camera import look_at
from gavatar_runtime.values.gaussians import Gaussians

scenes = st.builds(
    random_scene,
    st.integers(0, 10_000),
    st.integers(0, 80),
    isotropic=st.booleans(),
    opacity=st.booleans(),
    scale=st.sampled_from([1e-4, 0.01, 0.05, 0.3]),
)


@st.composite
def cameras(draw):
    """Any size from one pixel on, focal lengths from wide to long, a principal point even outside the image."""
    width, height = draw(st.integers(1, 70)), draw(st.integers(1, 50))
    focal = draw(st.floats(0.4, 4)) * max(width, height)
    aspect, right, down = draw(st.floats(0.8, 1.25)), draw(st.floats(-0.3, 1.3)), draw(st.floats(-0.3, 1.3))
    return simple_camera(width, height, focal, fy=focal * aspect, cx=right * width, cy=down * height)


@every
def test_random_scenes(target):
    target.build()

    # derandomised: a run of the suite is the same every time
    @settings(max_examples=40, deadline=None, derandomize=True, database=None)
    @given(scenes, cameras(), st.tuples(*3 * [st.floats(-1, 2)]))
    def holds(scene, camera, background):
        check(target, scene, camera, background)

    holds()


@functools.cache
def body(count: int, width: int, height: int, fill: float, alpha_max: float, slack: float):
    """A body scene, its camera and the reference picture, which takes a second."""
    scene, camera = body_scene(count), body_camera(width, height, fill=fill)
    scene = Gaussians(*(v if v is None else v.astype(np.float32) for v in vars(scene).values()))
    options = {"alpha_max": alpha_max, "slack": slack, "depth_slack": 1e-6}
    return scene, camera, reference_splat.render(scene, camera, (0.2, 0.5, 0.9), **options)


# the whole person, small and large; a close-up that most Gaussians lie outside of
@pytest.mark.parametrize("size", [(2000, 64, 64, 0.8), (8000, 288, 512, 0.8), (8000, 320, 240, 4.0)])
@every
def test_body(target, size):
    target.build()
    scene, camera, expected = body(*size, target.alpha_max, target.slack)
    got = target.draw(scene, camera, (0.2, 0.5, 0.9))
    judge(target, got, expected)
    assert 0.02 < expected.alpha.mean() < 0.9  # the body is in the picture, and does not fill it
    assert np.mean((got.color - expected.color) ** 2) < 1e-8  # 80 dB, the project's bound, flips included


@pytest.mark.parametrize("seed", range(3))
@every
def test_float64_is_exact_where_it_is_taken(target, seed):
    if target.name not in ("torch", "numpy", "auto"):
        pytest.skip(f"rasterizer={target.name} takes float32 alone")
    exact = dataclasses.replace(target, tolerance=1e-10, slack=1e-10, alpha_max=Target.alpha_max)
    scene = random_scene(seed, isotropic=seed == 0, opacity=seed == 1)
    rounded = scene.means.astype(np.float32).astype(np.float64)  # so that the order is by the same depths
    scene = dataclasses.replace(scene, means=rounded)
    camera = simple_camera(64, 48, cx=20.0, T_camera_world=look_at((0.3, 0.2, 0), (0, 0, 2)))
    expected = reference_splat.render(scene, camera, slack=1e-10, depth_slack=1e-10)
    got = exact.draw(scene, camera, dtype=torch.float64)
    assert got.color.dtype == np.float64
    judge(exact, got, expected)


@every
def test_equal_axes_any_rotation_and_opacity_one_are_the_isotropic_case(target):
    plain, camera = random_scene(0, 80), simple_camera(48, 40)
    quaternions = np.random.default_rng(5).normal(size=(80, 4)) * 3  # need not be of unit length
    general = dataclasses.replace(
        plain, scales=np.repeat(plain.scales[:, None], 3, 1), opacities=np.ones(80), quaternions=quaternions
    )
    judge(target, target.draw(general, camera), target.reference(plain, camera))


@pytest.mark.parametrize("quaternion", [(1, 0, 0, 0), (0, 0, 0, 0), (0, 1, 0, 0), (0, 0, -1, 0), (-1, 1e-20, 0, 0)])
@every
def test_rotations_of_nothing_and_of_pi(target, quaternion):
    scene = random_scene(1, 30, isotropic=False)
    scene.quaternions[:] = quaternion
    check(target, scene, simple_camera(48, 40))
