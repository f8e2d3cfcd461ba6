"""The compiled kernel: what its two bindings draw and refuse. Agreement with the other rasterizers on all kinds
of scenes stands in tests/plugins/rasterizers; here is what only the kernel can get wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from native_bench import GENERAL, GRADIENT, IMAGE, built, gradients, images, loss_of, reference, relative
from splat_scenes import FIELDS, as_numpy, as_torch, map_fields, random_scene, simple_camera

from gavatar_plugins.rasterizers.native import NativeRasterizer as Trainer
from gavatar_runtime import native_library as nl
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.rasterizers.native import NativeConfig
from gavatar_runtime.render.rasterizers.native import NativeRasterizer as Player
from gavatar_runtime.values.gaussians import Gaussians

pytestmark = [built, pytest.mark.usefixtures("kernel_defaults_afterwards")]


@pytest.mark.parametrize("isa", nl.instruction_sets() if nl.available()[0] else [])
@pytest.mark.parametrize("kind", [{}, {"opacity": True}, {"isotropic": False}, GENERAL])
def test_every_instruction_set_agrees_with_float64(isa, kind):
    nl.use_instruction_set(isa)
    assert nl.instruction_set() == isa
    scene, camera = as_numpy(random_scene(3, 150, **kind)), simple_camera(75, 51, cx=30.0)
    mine = gradients(Trainer(), scene, camera)
    exact = gradients(reference(), scene, camera, torch.float64)
    for a, b in zip(images(mine.pop("rendering")), images(exact.pop("rendering")), strict=True):
        np.testing.assert_allclose(a, b, atol=3 * IMAGE)  # depth reaches 3 m
    for name in exact:
        assert relative(mine[name], exact[name]) < GRADIENT, name


def test_player_and_trainer_draw_the_same_to_the_last_bit():
    scene, camera = as_numpy(random_scene(5, 200, **GENERAL)), simple_camera(90, 70)
    played = images(Player().render(scene, camera, (0.1, 0.5, 1.0)))
    trained = images(Trainer()(as_torch(scene), camera, (0.1, 0.5, 1.0)))
    for a, b in zip(played, trained, strict=True):
        np.testing.assert_array_equal(a, b)


def test_equal_depths_are_drawn_in_order_of_index():
    n = 3000  # more than a chunk: the bucket that holds them all is split
    rng = np.random.default_rng(0)
    means = np.stack([rng.uniform(-0.02, 0.02, n), rng.uniform(-0.02, 0.02, n), np.full(n, 2.0)], 1)
    scene = Gaussians(means, np.full(n, 0.02), rng.random((n, 3)), rng.uniform(0.005, 0.05, n))
    camera = simple_camera(64, 64)
    mine, exact = (
        Player().render(as_numpy(scene), camera),
        reference()(as_torch(as_numpy(scene), torch.float64), camera),
    )
    np.testing.assert_allclose(mine.color, exact.color.numpy(), atol=IMAGE)


def test_indices_beyond_a_million_are_exact():
    few = as_numpy(random_scene(2, 400))
    n = (1 << 20) + 5000  # from here on, entries hold coarser ranges of blocks
    means = np.full((n, 3), -1, np.float32)  # behind the camera
    scales, colors = np.full(n, 0.01, np.float32), np.zeros((n, 3), np.float32)
    means[-400:], scales[-400:], colors[-400:] = few.means, few.scales, few.colors
    camera, player = simple_camera(80, 60), Player()
    alone = images(player.render(few, camera))
    for a, b in zip(images(player.render(Gaussians(means, scales, colors), camera)), alone, strict=True):
        np.testing.assert_array_equal(a, b)


def test_buffers_are_used_again_for_the_same_size():
    player, camera = Player(), simple_camera(40, 30)
    first = player.render(as_numpy(random_scene(0)), camera).color
    kept = first.copy()
    second = player.render(as_numpy(random_scene(1)), camera).color
    assert second is first
    assert not np.array_equal(kept, second)
    assert player.render(as_numpy(random_scene(1)), simple_camera(30, 40)).color.shape == (40, 30, 3)


def test_bytes_are_the_rounded_picture():
    player, scene, camera = Player(), as_numpy(random_scene(0, 300)), simple_camera(61, 47)
    exact = np.clip(np.array(player.render(scene, camera, (0.2, 1.5, -1)).color), 0, 1)
    np.testing.assert_array_equal(
        player.render_uint8(scene, camera, (0.2, 1.5, -1)), (exact * 255 + 0.5).astype(np.uint8)
    )
    assert set(player.stage_seconds) == {"project", "sort", "blend"}


def test_depth_can_be_left_out():
    player = Player(NativeConfig(depth=False))
    assert player.render(as_numpy(random_scene(0)), simple_camera(20, 20)).depth is None


@pytest.mark.parametrize("size", [(1, 1), (33, 1), (4096, 4096)])
def test_no_gaussians_leave_the_background(size):
    empty = Gaussians(np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros((0, 3), np.float32))
    rendering = Player().render(empty, simple_camera(*size), (0.1, 0.2, 0.3))
    assert rendering.color.shape == (size[1], size[0], 3)
    assert (rendering.color == np.float32([0.1, 0.2, 0.3])).all()
    assert not rendering.alpha.any()
    assert not rendering.depth.any()


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_bad_value_drops_its_gaussian_and_nothing_else(field, value):
    scene, camera = as_numpy(random_scene(4, 80, **GENERAL)), simple_camera(60, 40)
    clean = Gaussians(**{name: np.delete(getattr(scene, name), 17, 0) for name in FIELDS})
    getattr(scene, field)[17] = value
    rendering = Player().render(scene, camera)
    assert rendering.dropped == 1
    result = gradients(Trainer(), scene, camera)
    np.testing.assert_array_equal(rendering.color, Player().render(clean, camera).color)
    for name in FIELDS:
        assert np.isfinite(result[name]).all()
        assert not result[name][17].any()


def test_shapes_that_do_not_belong_together_are_refused():
    scene = as_numpy(random_scene(0, 10))
    scene = dataclasses.replace(scene, colors=scene.colors[:9])
    with pytest.raises(ValueError, match=r"gaussians\.colors"):
        Player().render(scene, simple_camera(8, 8))
    with pytest.raises(ValueError, match=r"gaussians\.colors"):
        Trainer()(as_torch(scene), simple_camera(8, 8))


@pytest.mark.parametrize("change", [{"width": 0}, {"fx": 0.0}, {"cx": float("nan")}])
def test_a_camera_that_is_none_is_refused(change):
    camera = dataclasses.replace(simple_camera(8, 8), **change)
    with pytest.raises(UserError, match="camera"):
        Player().render(as_numpy(random_scene(0, 10)), camera)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16])
def test_other_dtypes_are_sent_to_torch(dtype):
    with pytest.raises(UserError, match="rasterizer=torch"):
        Trainer()(as_torch(random_scene(0, 10), dtype), simple_camera(8, 8))


def test_forwards_of_a_batch_may_go_backward_in_any_order_and_twice():
    camera, rasterizer = simple_camera(50, 40), Trainer()
    scenes = [as_numpy(random_scene(seed, 80)) for seed in range(3)]
    alone = [gradients(Trainer(), scene, camera)["means"] for scene in scenes]
    tensors = [map_fields(as_torch(scene), lambda x: x.requires_grad_()) for scene in scenes]
    losses = [loss_of(rasterizer(t, camera, (0.2, 0.4, 0.9))) for t in tensors]
    for k in (2, 0, 1, 0):
        (again,) = torch.autograd.grad(losses[k], [tensors[k].means], retain_graph=True)
        np.testing.assert_array_equal(again.numpy(), alone[k])


def test_frames_return_to_the_rasterizer(monkeypatch):
    made, frame = [], nl.Frame
    monkeypatch.setattr(nl, "Frame", lambda: made.append(frame()) or made[-1])
    rasterizer, camera, scene = Trainer(), simple_camera(30, 30), as_torch(random_scene(0, 20))
    scene.means.requires_grad_()
    for _ in range(3):
        rasterizer(scene, camera).color.sum().backward()
    with torch.no_grad():
        assert not rasterizer(scene, camera).color.requires_grad
    assert len(made) == 1


def test_arrays_need_not_be_contiguous():
    scene, camera = as_torch(random_scene(0, 50)), simple_camera(40, 40)
    plain = Trainer()(scene, camera).color
    scene = dataclasses.replace(scene, means=scene.means.T.contiguous().T)
    assert not scene.means.is_contiguous()
    torch.testing.assert_close(Trainer()(scene, camera).color, plain, rtol=0, atol=0)


def test_images_without_gradient_may_be_ignored():
    scene, camera = as_numpy(random_scene(0, 60, opacity=True)), simple_camera(40, 30)
    for pick in ("color", "alpha", "depth"):
        mine = map_fields(as_torch(scene), lambda x: x.requires_grad_())
        exact = map_fields(as_torch(scene, torch.float64), lambda x: x.requires_grad_())
        getattr(Trainer()(mine, camera), pick).square().sum().backward()
        getattr(reference()(exact, camera), pick).square().sum().backward()
        for name in ("means", "scales", "opacities"):
            assert relative(getattr(mine, name).grad.numpy(), getattr(exact, name).grad.numpy()) < GRADIENT
