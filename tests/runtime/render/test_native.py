"""The compiled kernel: bindings, threads, instruction sets, skinning. Agreement with the other rasterizers on all kinds
of scenes stands in tests/plugins/rasterizers; here is what only the kernel can get wrong."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch
from children import child_environment
from places import ROOT
from splat_scenes import FIELDS, as_numpy, as_torch, body_camera, body_scene, map_fields, random_scene, simple_camera

from gavatar.avatar.torch_skinning import dense_weights
from gavatar.avatar.torch_skinning import skin as torch_skin
from gavatar_plugins.rasterizers.native import NativeRasterizer as Trainer
from gavatar_plugins.rasterizers.native import NativeRasterizerConfig
from gavatar_plugins.rasterizers.torch_projection import project
from gavatar_plugins.rasterizers.torch_tiles import TorchRasterizer, TorchRasterizerConfig
from gavatar_runtime import native_library as nl
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry import kinematics
from gavatar_runtime.geometry.skinning import skin, skin_gradients
from gavatar_runtime.render.choice import player_rasterizers
from gavatar_runtime.render.rasterizers.native import NativeConfig, resize
from gavatar_runtime.render.rasterizers.native import NativeRasterizer as Player
from gavatar_runtime.splatting_rule import LOW_PASS
from gavatar_runtime.values.gaussians import Gaussians

built = pytest.mark.skipif(not nl.available()[0], reason=f"native kernel: {nl.available()[1]}")
pytestmark = built

# float32 sums of some hundred terms of order one, each with the kernel's relative error of 2e-7
IMAGE = 2e-5
# the same for gradients, whose terms cancel; relative to the gradient's norm
GRADIENT = 1e-4


@pytest.fixture(autouse=True)
def _defaults_afterwards():
    yield
    nl.set_threads(0)
    nl.use_instruction_set(None)


def images(rendering) -> list[np.ndarray]:
    values = (rendering.color, rendering.alpha, rendering.depth)
    return [x.detach().numpy().copy() if torch.is_tensor(x) else x.copy() for x in values]


def loss_of(rendering, seed: int = 0) -> torch.Tensor:
    """A fixed random linear function of the three images."""
    generator = torch.Generator().manual_seed(seed)
    parts = (rendering.color, rendering.alpha, rendering.depth)
    return sum((torch.rand(x.shape, generator=generator, dtype=torch.float64).to(x.dtype) * x).sum() for x in parts)


def gradients(rasterizer, scene: Gaussians, camera, dtype=torch.float32, background=(0.2, 0.4, 0.9)) -> dict:
    """By each field and the background, of `loss_of`; and the Rendering under 'rendering'."""
    tensors = map_fields(as_torch(scene, dtype), lambda x: x.requires_grad_())
    background = torch.tensor(background, dtype=dtype, requires_grad=True)
    rendering = rasterizer(tensors, camera, background)
    loss_of(rendering).backward()
    named = {name: getattr(tensors, name) for name in FIELDS} | {"background": background}
    return {k: v.grad.numpy() for k, v in named.items() if v is not None} | {"rendering": rendering}


def relative(a, b) -> float:
    return float(np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-12))


def reference() -> TorchRasterizer:
    return TorchRasterizer(TorchRasterizerConfig())


GENERAL = {"isotropic": False, "opacity": True}


# Agreement


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


# Switches


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


# Threads and processes


@pytest.mark.parametrize("kind", [{}, GENERAL])
def test_the_number_of_threads_changes_no_bit(kind):
    scene, camera = as_numpy(random_scene(7, 9000, scale=0.01, **kind)), simple_camera(200, 130)
    first = None
    for count in (1, 2, 3, 7):
        result = gradients(Trainer(NativeRasterizerConfig(threads=count)), scene, camera)
        assert nl.threads() == count
        everything = [*images(result.pop("rendering")), *result.values()]
        first = first or everything
        for a, b in zip(everything[:-1], first[:-1], strict=True):  # the background's gradient is torch's sum
            np.testing.assert_array_equal(a, b)


def test_threads_default_to_the_cores_of_the_process():
    nl.set_threads(0)
    assert nl.threads() == len(os.sched_getaffinity(0))
    with pytest.raises(UserError, match=r"rasterizer\.threads"):
        Player(NativeConfig(threads=-1))


def test_concurrent_callers_get_their_own_pictures():
    scenes = [as_numpy(random_scene(seed, 500, **GENERAL)) for seed in range(4)]
    camera = simple_camera(100, 80)
    alone = [np.array(Player().render(scene, camera).color) for scene in scenes]
    wrong = []

    def draw(k: int) -> None:
        player = Player()
        for _ in range(20):
            if not np.array_equal(player.render(scenes[k], camera).color, alone[k]):
                wrong.append(k)

    threads = [threading.Thread(target=draw, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for turn in range(10):  # a pool that changes size under way
        nl.set_threads(1 + turn % 3)
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_draws_too():
    script = """
import os, sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from splat_scenes import as_numpy, random_scene, simple_camera
from gavatar_runtime.render.rasterizers.native import NativeConfig, NativeRasterizer
player, camera = NativeRasterizer(NativeConfig(threads=2)), simple_camera(128, 96)
scene = as_numpy(random_scene(0, 20000, scale=0.01))
before = np.array(player.render(scene, camera).color)
child = os.fork()
same = np.array_equal(player.render(scene, camera).color, before)
if child == 0:
    os._exit(0 if same else 1)
sys.exit(0 if same and os.waitpid(child, 0)[1] == 0 else 1)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, str(ROOT / "tests" / "support")], timeout=60, env=child_environment()
    )
    assert done.returncode == 0


def test_denormals_are_left_alone():
    script = """
import numpy as np
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians
from gavatar_runtime.render.rasterizers.native import NativeRasterizer
one = np.ones((1, 3), np.float32)
NativeRasterizer().render(Gaussians(one, one[:, 0], one), Camera(8, 8, 8.0, 8.0, 4.0, 4.0, np.eye(4)))
tiny = np.full(100, np.finfo(np.float32).tiny)
assert (tiny / 2 > 0).all() and (tiny / 2 * 2 == tiny).all()
"""
    assert subprocess.run([sys.executable, "-c", script], timeout=60, env=child_environment()).returncode == 0


# The player's binding


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


# The training binding


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


def test_frames_return_to_the_rasterizer():
    rasterizer, camera, scene = Trainer(), simple_camera(30, 30), as_torch(random_scene(0, 20))
    scene.means.requires_grad_()
    for _ in range(3):
        rasterizer(scene, camera).color.sum().backward()
    with torch.no_grad():
        assert not rasterizer(scene, camera).color.requires_grad
    assert len(rasterizer._spare) == 1


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


# Skinning


def skinning_problem(n: int, slots: int, rows: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    weight = rng.random((n, slots)).astype(np.float32)
    weight /= weight.sum(1, keepdims=True)
    A = rng.normal(size=(24, rows, 4)).astype(np.float32)
    points = rng.normal(size=(n, 3)).astype(np.float32)
    return points, rng.integers(0, 24, (n, slots)).astype(np.int32), weight, A


@pytest.mark.parametrize("n", [0, 1, 257, 20000])
@pytest.mark.parametrize("slots", [1, 4, 7])
@pytest.mark.parametrize("rows", [3, 4])
def test_skinning_agrees_with_numpy(n, slots, rows):
    points, index, weight, A = skinning_problem(n, slots, rows)
    expected = kinematics.skin(points.astype(np.float64), index, weight, A.astype(np.float64))
    np.testing.assert_allclose(skin(points, index, weight, A), expected, atol=1e-5)  # a dozen float32 terms of order 1
    out = np.empty((n, 3), np.float32)
    assert skin(points, index.astype(np.int64), weight.astype(np.float64), A, out=out) is out
    np.testing.assert_allclose(out, expected, atol=1e-5)


def test_skinning_keeps_float64():
    points, index, weight, A = skinning_problem(10, 4, 4)
    assert skin(points.astype(np.float64), index, weight, A.astype(np.float64)).dtype == np.float64


@pytest.mark.parametrize("bad", [-1, 24])
def test_skinning_refuses_a_joint_that_is_not_there(bad):
    points, index, weight, A = skinning_problem(9000, 4, 4)
    index[8765, 2] = bad
    with pytest.raises(IndexError, match=r"0\.\.23"):
        skin(points, index, weight, A)


@pytest.mark.parametrize("slots", [1, 4, 7])
def test_skinning_gradients_agree_with_torch(slots):
    points, index, weight, A = skinning_problem(9000, slots, 3)
    upstream = np.random.default_rng(1).normal(size=points.shape).astype(np.float32)
    p, T = (torch.tensor(x.astype(np.float64), requires_grad=True) for x in (points, A))
    dense = torch.as_tensor(dense_weights(index, weight.astype(np.float64), 24))
    torch_skin(p, dense, T).backward(torch.as_tensor(upstream, dtype=torch.float64))
    by_points, by_A = skin_gradients(points, index, weight, A, upstream)
    assert relative(by_points, p.grad.numpy()) < 1e-6  # single sums in float32
    assert relative(by_A, T.grad.numpy()) < 1e-5  # thousands of float32 terms a sum
    nl.set_threads(1)
    np.testing.assert_array_equal(skin_gradients(points, index, weight, A, upstream)[1], by_A)
