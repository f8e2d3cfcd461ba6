"""The compiled kernel's switches: what each changes, and that training draws what the player draws."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from native_bench import GENERAL, GRADIENT, IMAGE, built, gradients, images, reference, relative
from splat_scenes import as_numpy, as_torch, body_camera, body_scene, map_fields, random_scene, simple_camera

from gavatar_plugins.rasterizers.native import NativeRasterizer as Trainer
from gavatar_plugins.rasterizers.native import NativeRasterizerConfig
from gavatar_plugins.rasterizers.torch_projection import project
from gavatar_runtime import native_library as nl
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.choice import player_rasterizers
from gavatar_runtime.render.rasterizers.native import NativeConfig, resize
from gavatar_runtime.render.rasterizers.native import NativeRasterizer as Player
from gavatar_runtime.splatting_rule import LOW_PASS
from gavatar_runtime.values.gaussians import Gaussians

pytestmark = [built, pytest.mark.usefixtures("kernel_defaults_afterwards")]


def psnr(a, b) -> float:
    return float(-10 * np.log10(np.mean((np.asarray(a, np.float64) - b) ** 2)))


# Measured on this scene: fast 81 dB, backface 46.9, depth_cut 46.0, resolution 32.7; the bounds leave 3 dB for other
# processors' rounding of which Gaussians fall under a threshold.
@pytest.mark.parametrize(
    ("options", "least"),
    [({"fast": True}, 78), ({"backface": 0.3}, 43), ({"depth_cut": 0.3}, 43), ({"resolution": 0.75}, 29)],
)
def test_a_switch_changes_the_picture_by_no_more_than_is_documented(options, least):
    scene, camera = as_numpy(body_scene(50000)), body_camera(256, 256)
    exact = np.array(Player().render(scene, camera).color)
    player = Player(NativeConfig(**options))
    assert least < psnr(player.render(scene, camera).color, exact) < 100
    rounded = psnr(exact, np.round(255 * exact) / 255)
    assert min(least, rounded) - 2 < psnr(player.render_uint8(scene, camera) / 255.0, exact) < 100


SWITCHES = ({"fast": True}, {"backface": 0.3}, {"depth_cut": 0.3}, {"resolution": 0.6}, {"antialiased": True})


@pytest.mark.parametrize("options", SWITCHES)
def test_training_with_a_switch_draws_what_the_player_draws(options):
    scene, camera = as_numpy(body_scene(20000)), body_camera(150, 130)
    tensors = dataclasses.replace(as_torch(scene), normals=torch.as_tensor(scene.normals))
    mine = Trainer(NativeRasterizerConfig(**options))(tensors, camera)
    plain = Trainer()(tensors, camera)
    assert psnr(mine.color.numpy(), plain.color.numpy()) < 100
    played = Player(NativeConfig(**options)).render(scene, camera)
    for a, b in zip(images(mine), images(played), strict=True):
        # torch and OpenCV enlarge with weights of their own rounding
        np.testing.assert_allclose(a, b, atol=2e-4 if "resolution" in options else 0, rtol=0)


@pytest.mark.parametrize("isa", nl.instruction_sets() if nl.available()[0] else [])
@pytest.mark.parametrize("options", SWITCHES)
def test_gradients_with_a_switch_are_those_of_the_picture_that_was_drawn(isa, options):
    nl.use_instruction_set(isa)
    scene, camera = as_numpy(body_scene(20000)), body_camera(150, 130)
    tensors = dataclasses.replace(
        map_fields(as_torch(scene), lambda x: x.requires_grad_()), normals=torch.as_tensor(scene.normals)
    )
    rendering = Trainer(NativeRasterizerConfig(**options))(tensors, camera, (0.0, 0.0, 0.0))
    upstream = torch.rand(rendering.color.shape, generator=torch.Generator().manual_seed(0))
    colors, scales = torch.autograd.grad(rendering.color, (tensors.colors, tensors.scales), upstream)
    # the picture is linear in the colors: a Gaussian or a pixel that forward and backward treat otherwise would show
    drawn, replayed = (rendering.color * upstream).sum(), (colors * tensors.colors).sum()
    torch.testing.assert_close(replayed, drawn, rtol=3e-5, atol=0)
    assert scales.isfinite().all()
    assert scales.abs().sum() > 0


def test_the_backward_of_a_fast_forward_is_nearly_the_exact_one():
    scene, camera = as_numpy(random_scene(6, 400, opacity=True)), simple_camera(90, 70)
    exact, fast = (gradients(Trainer(NativeRasterizerConfig(fast=f)), scene, camera) for f in (False, True))
    for name in ("means", "scales", "colors", "opacities"):
        # 7.5e-5 relative in each alpha, and an end of blocks at 4e-3 of transmittance
        assert np.linalg.norm(fast[name] - exact[name]) < 5e-3 * np.linalg.norm(exact[name]), name


def test_numpy_draws_antialiased_as_native_does():
    for seed, kind in ((3, {}), (4, {"opacity": True}), (5, {"isotropic": False})):
        scene, camera = as_numpy(random_scene(seed, 150, scale=0.012, **kind)), simple_camera(75, 51, cx=30.0)
        plain = player_rasterizers().build("numpy").render(scene, camera).color
        mine = player_rasterizers().build("numpy", {"antialiased": True}).render(scene, camera)
        assert np.abs(mine.color - plain).max() > 0.01
        native = Player(NativeConfig(antialiased=True)).render(scene, camera)
        for a, b in zip(images(mine), images(native), strict=True):
            np.testing.assert_allclose(a, b, atol=3 * IMAGE)


def test_backfaces_are_left_out_only_where_there_are_normals_and_a_switch():
    scene, camera = as_numpy(body_scene(20000)), body_camera(128, 128)
    away = np.einsum("nk,nk->n", scene.normals, camera_centre(camera) - scene.means)
    away /= np.linalg.norm(camera_centre(camera) - scene.means, axis=1)
    seen = Gaussians(*(getattr(scene, name)[away >= -0.3] for name in ("means", "scales", "colors")))
    assert 0.4 < len(seen) / len(scene) < 0.8
    np.testing.assert_array_equal(
        Player(NativeConfig(backface=0.3)).render(scene, camera).color.copy(), Player().render(seen, camera).color
    )
    exact = Player().render(scene, camera).color.copy()
    scene = dataclasses.replace(scene, normals=None)
    np.testing.assert_array_equal(Player(NativeConfig(backface=0.3)).render(scene, camera).color, exact)


def camera_centre(camera) -> np.ndarray:
    return -camera.T_camera_world[:3, :3].T @ camera.T_camera_world[:3, 3]


def test_the_depth_cut_counts_from_the_nearest_of_the_tile():
    means = np.float32([[0, 0, 1], [0, 0, 1.9], [0, 0, 2.1], [0, 0, 3]])
    scene = Gaussians(means, np.full(4, 0.02, np.float32), np.eye(4, 3, dtype=np.float32), np.full(4, 0.5, np.float32))
    camera = simple_camera(32, 32)
    cut = Player(NativeConfig(depth_cut=1.0)).render(scene, camera)
    near = Gaussians(*(getattr(scene, name)[:2] for name in ("means", "scales", "colors", "opacities")))
    np.testing.assert_array_equal(cut.color.copy(), Player().render(near, camera).color)


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (37, 23)])
def test_reduced_resolution_fills_the_whole_image(size):
    one = np.ones((1, 3), np.float32)
    wall = Gaussians(one * [0, 0, 1], 10 * one[:, 0], one * [0.2, 0.4, 0.6])
    rendering = Player(NativeConfig(resolution=0.3)).render(wall, simple_camera(*size))
    assert rendering.color.shape == (size[1], size[0], 3)
    assert rendering.alpha.shape == rendering.depth.shape == (size[1], size[0])
    np.testing.assert_allclose(rendering.depth, 0.99, atol=1e-3)  # ALPHA_MAX of a wall at 1 m


@pytest.mark.parametrize("shape", [(1, 1), (1, 7, 3), (9, 1), (40, 31, 3), (64, 48), (255, 256, 3)])
@pytest.mark.parametrize("to", [(1, 1), (37, 53), (128, 96), (511, 300)])
def test_images_are_enlarged_as_opencv_does_it(shape, to):
    cv2 = pytest.importorskip("cv2")
    image = np.random.default_rng(0).random(shape, np.float32)
    out = np.empty((*to, *shape[2:]), np.float32)
    resize(image, out)
    expected = cv2.resize(image, to[::-1], interpolation=cv2.INTER_LINEAR).reshape(out.shape)
    # cv2 rounds where a pixel lies to float32: 1e-5 of a pixel at 256, times differences of up to 1
    np.testing.assert_allclose(out, expected, atol=5e-5, rtol=0)
    image8, out8 = np.rint(255 * image).astype(np.uint8), np.empty(out.shape, np.uint8)
    resize(image8, out8)
    expected = cv2.resize(image8, to[::-1], interpolation=cv2.INTER_LINEAR).reshape(out.shape)
    assert np.abs(out8.astype(int) - expected).max() <= 1  # cv2 rounds its weights to 11 bits


def compensated(scene: Gaussians, camera) -> Gaussians:
    """The opacities that make the plain rule antialiased, by torch's projection and autograd."""
    splats = project(scene, camera)
    a, b, c = splats.conic.unbind(1)
    blurred = 1 / (a * c - b * b)  # det of the covariance with the low-pass
    sharp = (c * blurred - LOW_PASS) * (a * blurred - LOW_PASS) - (b * blurred) ** 2
    compensation = (sharp / blurred).clamp(min=1e-30).sqrt()
    opacities = compensation if scene.opacities is None else scene.opacities * compensation
    return dataclasses.replace(scene, opacities=opacities)


@pytest.mark.parametrize("isa", nl.instruction_sets() if nl.available()[0] else [])
@pytest.mark.parametrize("kind", [{}, {"opacity": True}, {"isotropic": False}, GENERAL])
def test_antialiasing_is_the_rule_with_compensated_opacities(isa, kind):
    nl.use_instruction_set(isa)
    scene, camera = as_numpy(random_scene(3, 150, scale=0.012, **kind)), simple_camera(75, 51, cx=30.0)  # about a pixel
    mine = gradients(Trainer(NativeRasterizerConfig(antialiased=True)), scene, camera)
    exact = gradients(lambda s, *rest: reference()(compensated(s, camera), *rest), scene, camera, torch.float64)
    played = Player(NativeConfig(antialiased=True)).render(scene, camera, (0.2, 0.4, 0.9))
    for a, b in zip(images(played), images(mine["rendering"]), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(images(mine.pop("rendering")), images(exact.pop("rendering")), strict=True):
        np.testing.assert_allclose(a, b, atol=3 * IMAGE)
    for name in exact:
        assert relative(mine[name], exact[name]) < GRADIENT, name


def test_antialiased_light_does_not_grow_with_distance():
    one = np.ones((1, 3), np.float32)

    def light(distance: float, **options) -> float:
        scene = Gaussians(one * [0, 0, distance], 0.02 * one[:, 0], one)
        alpha = Player(NativeConfig(**options)).render(scene, simple_camera(65, 65)).alpha
        return float(alpha.sum()) * distance**2

    near = light(1)
    assert light(8) > 5 * near  # the low-pass makes it larger than it is
    assert light(8, antialiased=True) == pytest.approx(near, rel=0.35)  # the 1/255 skip takes the rest


@pytest.mark.parametrize("options", [{"backface": 1.0}, {"depth_cut": -1}, {"resolution": 0}, {"resolution": 2.0}])
def test_a_switch_out_of_range_is_named(options):
    with pytest.raises(UserError, match=rf"rasterizer\.{next(iter(options))}"):
        NativeConfig(**options)
