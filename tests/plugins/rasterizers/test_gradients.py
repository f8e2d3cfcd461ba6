"""Every differentiable rasterizer has the gradients of the float64 rule, and those are the finite differences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference_gradients
import reference_splat
import torch
from rasterizer_bench import every, every_differentiable
from splat_scenes import FIELDS, as_torch, random_scene, select, simple_camera

from gavatar.registry import RASTERIZERS
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.camera import look_at
from gavatar_runtime.values.gaussians import Gaussians

KINDS = {
    "isotropic": {},
    "opacities": {"opacity": True},
    "general": {"isotropic": False, "opacity": True},
    "wide": {"scale": 0.3},  # every pixel stops, and most of every support lies outside
}
CAMERAS = {
    "plain": simple_camera(48, 40),
    "off centre": simple_camera(
        40, 48, 60.0, fy=50.0, cx=-15.0, cy=60.0, T_camera_world=look_at((1, 1, -1), (0, 0, 2))
    ),
}


def leaves(target, scene: Gaussians, dtype) -> dict[str, torch.Tensor]:
    device = getattr(target, "device", "cpu")
    fields = vars(as_torch(scene, dtype)) | {"background": torch.tensor([0.2, 0.5, 0.9], dtype=dtype)}
    return {k: v.to(device).requires_grad_() for k, v in fields.items() if v is not None}


def gradients(draw, inputs: dict[str, torch.Tensor], upstream: list[np.ndarray]) -> dict[str, np.ndarray]:
    """By each of `inputs`, of the sum of images times `upstream`."""
    background = inputs["background"]
    picture = draw(Gaussians(**{k: v for k, v in inputs.items() if k != "background"}), background)
    images = (picture.color, picture.alpha, picture.depth)
    loss = sum((image * torch.as_tensor(u).to(image)).sum() for image, u in zip(images, upstream, strict=True))
    found = torch.autograd.grad(loss, list(inputs.values()))
    return {k: g.double().cpu().numpy() for k, g in zip(inputs, found, strict=True)}


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", KINDS)
@every_differentiable
def test_float32_gradients_are_those_of_float64(target, kind, camera):
    rasterizer, camera = target.build(), CAMERAS[camera]
    scene = random_scene(4, 60, **KINDS[kind])
    scene = Gaussians(**{k: None if v is None else v.astype(np.float32) for k, v in vars(scene).items()})
    expected_picture = target.reference(scene, camera)
    # a pixel that decided otherwise has another gradient: those in doubt are left out
    sure = ~expected_picture.doubtful
    assert sure.mean() > 0.9
    rng = np.random.default_rng(0)
    upstream = [
        rng.normal(size=sure.shape + tail) * sure.reshape(sure.shape + (1,) * len(tail)) for tail in ((3,), (), ())
    ]

    def exact(gaussians, background):
        options = {"alpha_max": target.alpha_max, "through_clamp": target.through_clamp}
        return reference_gradients.render(gaussians, camera, background, **options)

    got = gradients(lambda g, b: rasterizer(g, camera, b), leaves(target, scene, torch.float32), upstream)
    expected = gradients(exact, leaves(None, scene, torch.float64), upstream)
    for name, value in expected.items():
        error = np.linalg.norm(got[name] - value) / max(np.linalg.norm(value), 1e-6)
        assert error < target.gradient, f"{name}: {error:.1e}"


@pytest.mark.parametrize("kind", KINDS)
def test_the_two_references_draw_the_same(kind):
    scene, camera = random_scene(4, 60, **KINDS[kind]), CAMERAS["off centre"]
    background = torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64)
    dense = reference_gradients.render(as_torch(scene, torch.float64), camera, background)
    plain = reference_splat.render(scene, camera, background.numpy())
    for image in ("color", "alpha", "depth"):
        np.testing.assert_allclose(getattr(dense, image).numpy(), getattr(plain, image), atol=1e-10)  # float64 rounding


def smooth_scene(isotropic: bool) -> tuple[Gaussians, object]:
    """Four Gaussians whose supports hold the whole image, one with its centre beyond the frustum margin, and none that
    is clamped or stops a pixel: the rule is smooth in a neighbourhood."""
    rng = np.random.default_rng(1)
    means = np.array([[0.1, -0.1, 2.0], [-0.2, 0.1, 2.3], [1.2, 0.2, 2.1], [0.0, -1.1, 2.6]])
    scales = rng.uniform(0.9, 1.2, 4 if isotropic else (4, 3))
    scene = Gaussians(means, scales, rng.random((4, 3)), rng.uniform(0.3, 0.6, 4))
    if not isotropic:
        scene = dataclasses.replace(scene, quaternions=rng.normal(size=(4, 4)))
    camera = simple_camera(6, 5, 9.0, fy=8.0, cx=2.0, T_camera_world=look_at((0.2, 0.1, -0.1), (0, 0, 2)))
    return scene, camera


@pytest.mark.parametrize("isotropic", [True, False])
@pytest.mark.parametrize("renderer", ["reference", *RASTERIZERS.names()])
def test_float64_gradients_are_finite_differences(renderer, isotropic):
    scene, camera = smooth_scene(isotropic)
    inputs = leaves(None, scene, torch.float64)
    if renderer == "reference":

        def draw(gaussians, background):
            return reference_gradients.render(gaussians, camera, background)

    else:
        if not RASTERIZERS.traits(renderer).differentiable:
            pytest.skip(f"rasterizer={renderer} has no gradients")
        try:
            rasterizer = RASTERIZERS.build(renderer)
            rasterizer(Gaussians(**{k: v for k, v in inputs.items() if k != "background"}), camera)
        except UserError as error:
            pytest.skip(str(error))

        def draw(gaussians, background):
            return rasterizer(gaussians, camera, background)

    def images(*values):
        named = dict(zip(inputs, values, strict=True))
        picture = draw(Gaussians(**{k: v for k, v in named.items() if k != "background"}), named["background"])
        return picture.color, picture.alpha, picture.depth

    # central differences of step 1e-6 in float64: their own error is about 1e-9
    assert torch.autograd.gradcheck(images, list(inputs.values()), eps=1e-6, atol=1e-7, rtol=1e-6)


@every_differentiable
def test_dropped_and_hidden_gaussians_get_zero_and_spoil_nothing(target):
    rasterizer, camera = target.build(), simple_camera(30, 24)
    scene = random_scene(9, 30, isotropic=False, opacity=True)
    scene.means[3, 0], scene.scales[5, 1], scene.colors[7, 2] = np.nan, np.inf, -np.inf
    scene.opacities[9], scene.quaternions[11, 0] = np.nan, np.inf
    scene.means[13] = [0, 0, -2]
    scene.means[15] = [500, 0, 2]
    rng = np.random.default_rng(0)
    upstream = [rng.normal(size=(24, 30, *tail)) for tail in ((3,), (), ())]
    got = gradients(lambda g, b: rasterizer(g, camera, b), leaves(target, scene, torch.float32), upstream)
    for name, value in got.items():
        assert np.isfinite(value).all(), name
        if name != "background":
            assert not value[[3, 5, 7, 9, 11, 13, 15]].any(), name
    keep = np.setdiff1d(np.arange(30), [3, 5, 7, 9, 11, 13, 15])
    clean = leaves(target, select(scene, keep), torch.float32)
    alone = gradients(lambda g, b: rasterizer(g, camera, b), clean, upstream)
    for name in FIELDS:
        scale = np.abs(alone[name]).max()
        np.testing.assert_allclose(got[name][keep], alone[name], atol=1e-5 * scale)  # sums in another order


@every_differentiable
def test_no_gaussians_have_gradients_of_no_length(target):
    rasterizer = target.build()
    nothing = Gaussians(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    inputs = leaves(target, nothing, torch.float32)
    background = inputs.pop("background")
    picture = rasterizer(Gaussians(**inputs), simple_camera(8, 6), background)
    picture.color.sum().backward()
    assert background.grad.tolist() == [48, 48, 48]
    assert all(v.grad is None or v.grad.shape == v.shape for v in inputs.values())


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e3])
@every_differentiable
def test_gradients_stay_finite_at_any_scale(target, scale):
    rasterizer, camera = target.build(), simple_camera(30, 24)
    scene = random_scene(10, 30)
    scene.scales[::2] = scale
    got = gradients(
        lambda g, b: rasterizer(g, camera, b),
        leaves(target, scene, torch.float32),
        [np.ones((24, 30, 3)), *2 * [np.ones((24, 30))]],
    )
    assert all(np.isfinite(value).all() for value in got.values())


@every
def test_a_rasterizer_without_gradients_says_what_has_them(target):
    if RASTERIZERS.traits(target.name).differentiable:
        pytest.skip("it has gradients")
    scene = leaves(target, random_scene(0, 3), torch.float32)
    scene.pop("background")
    with pytest.raises(UserError, match="rasterizer=torch"):
        target.build()(Gaussians(**scene), simple_camera(8, 8))
