"""The projection beside that of gsplat's pure-torch reference, and what the plugin hands to gsplat's kernels."""

from __future__ import annotations

import dataclasses
import inspect

import numpy as np
import pytest
import torch
from rasterizer_bench import judge
from rasterizer_bench import target as target_of
from splat_scenes import as_torch, random_scene, simple_camera

from gavatar.registry import RASTERIZERS
from gavatar_plugins.rasterizers import gsplat as plugin
from gavatar_plugins.rasterizers.torch_projection import project
from gavatar_runtime.errors import UserError
from gavatar_runtime.splatting_rule import ALPHA_MIN, LOW_PASS, NEAR, TRANSMITTANCE_STOP
from gavatar_runtime.values.camera import look_at
from gavatar_runtime.values.gaussians import Gaussians

gsplat = pytest.importorskip("gsplat", minversion="1.5", reason="needs gsplat 1.5 (pip install 'gavatar[dev]')")
theirs = pytest.importorskip("gsplat.cuda._torch_impl")

CAMERAS = {
    "plain": simple_camera(48, 40),
    # a principal point off centre, where the older bound of 1.3 tan(FoV / 2) on both sides alike would be wrong
    "off centre": simple_camera(
        48, 40, 30.0, fy=36.0, cx=-20.0, cy=55.0, T_camera_world=look_at((1, 1, -1), (0, 0, 2))
    ),
}


def their_projection(scene: Gaussians, camera):
    """radii (N, 2), xy (N, 2), depth (N,), conic (N, 3) of float64 tensors."""
    n = len(scene.means)
    scales = scene.scales[:, None].expand(n, 3) if scene.scales.ndim == 1 else scene.scales
    quaternions = (
        torch.tensor([[1.0, 0, 0, 0]]).double().expand(n, 4) if scene.quaternions is None else scene.quaternions
    )
    covariances, _ = theirs._quat_scale_to_covar_preci(quaternions, scales, True, False)
    K = torch.tensor([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]).double()
    view = torch.as_tensor(camera.T_camera_world)
    found = theirs._fully_fused_projection(
        scene.means, covariances, view[None], K[None], camera.width, camera.height, eps2d=LOW_PASS, near_plane=NEAR
    )
    return tuple(values[0] for values in found[:4])


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("isotropic", [True, False])
def test_centres_depths_conics_and_their_gradients_agree(isotropic, camera):
    camera = CAMERAS[camera]
    scene = as_torch(random_scene(0, 300, isotropic=isotropic), torch.float64)
    wide = torch.tensor([2.0, 2.0, 1.0]).double()  # many beyond the frustum margin
    scene = dataclasses.replace(scene, means=scene.means * wide)
    fields = [value.requires_grad_() for value in vars(scene).values() if value is not None]
    splats = project(scene, camera)
    _, xy, depth, conic = their_projection(scene, camera)
    for mine, other in ((splats.xy, xy), (splats.depth, depth), (splats.conic, conic)):
        # float64 whose determinants are by two formulas: measured 3e-15 relative, a thousandfold for other processors
        torch.testing.assert_close(mine, other, rtol=1e-12, atol=1e-12)
    upstream = [
        torch.randn(t.shape, generator=torch.Generator().manual_seed(k)).double() for k, t in enumerate((xy, conic))
    ]
    mine = torch.autograd.grad([splats.xy, splats.conic], fields, upstream, allow_unused=True)
    other = torch.autograd.grad([xy, conic], fields, upstream, allow_unused=True)
    for a, b in zip(mine, other, strict=True):
        if b is not None:  # colours have no part in it
            # measured 3e-14 relative of gradients of up to 360
            torch.testing.assert_close(a, b, rtol=1e-11, atol=1e-11)


def test_their_radii_hold_our_support():
    """So that a tile which gsplat does not visit has nothing that the rule would draw."""
    camera = CAMERAS["plain"]
    scene = as_torch(random_scene(1, 300, isotropic=False), torch.float64)
    splats, (radii, *_) = project(scene, camera), their_projection(scene, camera)
    shown = (radii > 0).all(1)
    assert shown.sum() > 100
    assert (radii[shown] >= splats.extent[shown]).all()
    assert (radii[shown] <= splats.extent[shown] * 1.001 + 1).all()


def stand_in(*arguments, **options):
    """gsplat.rasterization on the CPU: its own projection, and its kernel's blending without tiles."""
    call = inspect.signature(gsplat.rasterization).bind(*arguments, **options)  # what it does not know it refuses
    call.apply_defaults()
    a = call.arguments
    assert a["render_mode"] == "RGB+D"
    assert a["covars"] is None
    covariances, _ = theirs._quat_scale_to_covar_preci(a["quats"], a["scales"], True, False)
    radii, xy, depth, conic, _ = theirs._fully_fused_projection(
        a["means"],
        covariances,
        a["viewmats"],
        a["Ks"],
        a["width"],
        a["height"],
        a["eps2d"],
        a["near_plane"],
        a["far_plane"],
    )
    keep = (radii[0] > 0).all(1)
    order = torch.sort(torch.where(keep, depth[0], torch.inf), stable=True)[1][: int(keep.sum())]
    rows, columns = torch.meshgrid(torch.arange(a["height"]) + 0.5, torch.arange(a["width"]) + 0.5, indexing="ij")
    color, passing = torch.zeros((a["height"], a["width"], 4)), torch.ones((a["height"], a["width"]))
    done = torch.zeros_like(passing, dtype=torch.bool)
    for i in order.tolist():
        dx, dy = xy[0, i, 0] - columns, xy[0, i, 1] - rows
        sigma = 0.5 * (conic[0, i, 0] * dx * dx + conic[0, i, 2] * dy * dy) + conic[0, i, 1] * dx * dy
        alpha = (a["opacities"][i] * torch.exp(-sigma)).clamp(max=0.999)
        seen = (alpha >= ALPHA_MIN) & ~done
        done |= seen & (passing * (1 - alpha) <= TRANSMITTANCE_STOP)
        alpha = torch.where(seen & ~done, alpha, 0)
        color += (alpha * passing)[..., None] * torch.cat([a["colors"][i], depth[0, i, None]])
        passing = passing * (1 - alpha)
    return color[None], (1 - passing)[None, ..., None], {}


@pytest.fixture
def on_the_cpu(monkeypatch):
    """The plugin without CUDA: its tensors may lie anywhere, and gsplat's kernels are the stand-in."""
    monkeypatch.setattr(plugin, "_load", lambda: stand_in)
    monkeypatch.setattr(plugin, "_check", lambda gaussians: None)
    return plugin.GsplatRasterizer()


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", [{}, {"opacity": True}, {"isotropic": False, "opacity": True}])
def test_the_plugin_draws_the_rule(on_the_cpu, kind, camera):
    scene, camera = random_scene(3, 40, **kind), CAMERAS[camera]
    scene.means[5, 1], scene.colors[6] = np.nan, np.inf
    scene.means[7] = [0, 0, np.float32(NEAR)]  # gsplat would draw it
    if scene.quaternions is not None:
        scene.quaternions[8] = 0
    target = dataclasses.replace(target_of("gsplat", "cuda"), tolerance=1e-5)
    got = on_the_cpu(as_torch(scene), camera, (0.2, 0.5, 0.9))
    assert got.dropped == 2
    images = {name: getattr(got, name).numpy() for name in ("color", "alpha", "depth")}
    judge(target, dataclasses.replace(got, **images), target.reference(scene, camera, (0.2, 0.5, 0.9)))


def test_the_plugin_says_what_it_lacks(monkeypatch):
    with pytest.raises(UserError, match="tile_size"):
        RASTERIZERS.build("gsplat", {"tile_size": 5})
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UserError, match="needs a CUDA device"):
        RASTERIZERS.build("gsplat")
    monkeypatch.setattr(gsplat, "__version__", "1.4.0")
    with pytest.raises(UserError, match=r"found 1\.4\.0"):
        RASTERIZERS.build("gsplat")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_plugin_refuses_what_is_not_float32_on_cuda(monkeypatch, dtype):
    monkeypatch.setattr(plugin, "_load", lambda: stand_in)
    with pytest.raises(UserError, match="use rasterizer=auto"):
        plugin.GsplatRasterizer()(as_torch(random_scene(0, 3), dtype), simple_camera(8, 8))
