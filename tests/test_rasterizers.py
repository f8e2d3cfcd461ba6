"""One contract for every rasterizer: the rule of `rasterizers/rules.py`, against a plain per-splat float64 loop."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gavatar.registry import RASTERIZERS, load_plugins
from gavatar_runtime.camera import Camera, look_at
from gavatar_runtime.errors import UserError
from gavatar_runtime.gaussians import Gaussians
from gavatar_runtime.rasterizers.rules import ALPHA_MAX, ALPHA_MIN, NEAR, TRANSMITTANCE_STOP

load_plugins()
NAMES = RASTERIZERS.names()


def camera(width=48, height=40, **changes) -> Camera:
    values = {"fx": 60.0, "fy": 55.0, "cx": width / 2, "cy": height / 2, **changes}
    return Camera(width, height, **values, T_camera_world=look_at((0, 0, -3), (0, 0, 0)))


def scene(count=200, seed=0, spread=0.8, scale=(0.01, 0.15)) -> Gaussians:
    rng = np.random.default_rng(seed)
    return Gaussians(rng.normal(size=(count, 3)) * spread, rng.uniform(*scale, count), rng.random((count, 3)))


def reference(gaussians: Gaussians, cam: Camera, background=(1.0, 1.0, 1.0)) -> np.ndarray:
    """Isotropic Gaussians, one at a time over every pixel, as the rule reads."""
    R, t = cam.T_camera_world[:3, :3], cam.T_camera_world[:3, 3]
    points = gaussians.means @ R.T + t
    py, px = np.mgrid[: cam.height, : cam.width] + 0.5
    image, T = np.zeros((cam.height, cam.width, 3)), np.ones((cam.height, cam.width))
    alive = np.ones_like(T, bool)
    for i in np.argsort(points[:, 2].astype(np.float32), kind="stable"):
        x, y, z = points[i]
        if not z > NEAR:
            continue
        u = np.clip(x / z, -(cam.cx + 0.15 * cam.width) / cam.fx, (1.15 * cam.width - cam.cx) / cam.fx)
        v = np.clip(y / z, -(cam.cy + 0.15 * cam.height) / cam.fy, (1.15 * cam.height - cam.cy) / cam.fy)
        J = np.array([[cam.fx / z, 0, -cam.fx * u / z], [0, cam.fy / z, -cam.fy * v / z]])
        conic = np.linalg.inv(gaussians.scales[i] ** 2 * J @ J.T + 0.3 * np.eye(2))
        d = np.stack([px - (cam.fx * x / z + cam.cx), py - (cam.fy * y / z + cam.cy)], -1)
        alpha = np.minimum(ALPHA_MAX, np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", d, conic, d)))
        alpha[(alpha < ALPHA_MIN) | ~alive] = 0
        stops = T * (1 - alpha) < TRANSMITTANCE_STOP
        alive &= ~stops
        alpha[stops] = 0
        image += (alpha * T)[..., None] * gaussians.colors[i]
        T = T * (1 - alpha)
    return image + T[..., None] * np.asarray(background)


def draw(name: str, gaussians: Gaussians, cam: Camera, background=(1.0, 1.0, 1.0), dtype=torch.float32):
    def tensor(a):
        return None if a is None else torch.as_tensor(np.asarray(a), dtype=dtype)

    fields = (gaussians.means, gaussians.scales, gaussians.colors, gaussians.opacities, gaussians.quaternions)
    try:
        rasterizer = RASTERIZERS.build(name)
    except UserError as error:
        pytest.skip(str(error))
    return rasterizer(Gaussians(*map(tensor, fields)), cam, background)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(3))
def test_random_scenes_agree_with_the_reference(name, seed):
    cam = camera(cx=19.0 + 4 * seed)
    got, expected = (
        draw(name, scene(seed=seed), cam, (0.2, 0.5, 0.9)),
        reference(scene(seed=seed), cam, (0.2, 0.5, 0.9)),
    )
    error = np.abs(got.color.numpy() - expected).max(-1)
    # float32 exponents of a few units: 1e-4 apart from pixels where rounding crosses the skip at 1/255 or the stop
    assert (error > 1e-4).mean() < 0.005
    assert error.max() < 2 / 255
    assert got.dropped == 0


@pytest.mark.parametrize("name", NAMES)
def test_nothing_one_behind_and_beyond(name):
    cam = camera()
    empty = Gaussians(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    assert np.allclose(draw(name, empty, cam).color, 1)
    hidden = np.array([[0, 0, -3], [0, 0, -3 + NEAR / 2], [0, 0, -9], [99, 0, 0], [0, -99, 0]], float)
    picture = draw(name, Gaussians(hidden, np.full(5, 0.01), np.zeros((5, 3))), cam)
    assert np.allclose(picture.color, 1)
    one = Gaussians(np.zeros((1, 3)), np.array([0.05]), np.array([[1.0, 0, 0]]))
    assert np.abs(draw(name, one, cam).color.numpy() - reference(one, cam)).max() < 1e-4
    assert draw(name, one, camera(1, 1)).color.shape == (1, 1, 3)


@pytest.mark.parametrize("name", NAMES)
def test_non_finite_and_negative_fields_are_dropped_counted_and_never_spread(name):
    clean, dirty = scene(60), scene(60)
    dirty.means[3, 1], dirty.scales[7], dirty.colors[11, 2], dirty.scales[15] = np.nan, np.inf, np.nan, -1
    keep = ~np.isin(np.arange(60), [3, 7, 11, 15])
    clean = Gaussians(clean.means[keep], clean.scales[keep], clean.colors[keep])
    got, expected = draw(name, dirty, camera()), draw(name, clean, camera())
    assert got.dropped == 4
    assert torch.equal(got.color, expected.color)


@pytest.mark.parametrize("name", NAMES)
def test_exact_ties_are_drawn_in_index_order_and_many_on_one_pixel_saturate(name):
    tie = Gaussians(np.zeros((2, 3)), np.full(2, 0.2), np.array([[1.0, 0, 0], [0, 1.0, 0]]))
    assert np.abs(draw(name, tie, camera()).color.numpy() - reference(tie, camera())).max() < 1e-4
    pile = Gaussians(np.zeros((20_000, 3)), np.full(20_000, 0.01), np.tile([[0.0, 0.5, 1.0]], (20_000, 1)))
    picture = draw(name, pile, camera())
    assert torch.isfinite(picture.color).all()
    assert picture.alpha.max() <= 1


@pytest.mark.parametrize("name", NAMES)
def test_scales_from_nanometres_to_kilometres_stay_finite(name):
    many = scene(40)
    many.scales[:] = np.geomspace(1e-9, 1e3, 40)
    picture = draw(name, many, camera())
    assert all(torch.isfinite(x).all() for x in (picture.color, picture.alpha, picture.depth))


@pytest.mark.parametrize("name", NAMES)
def test_equal_axes_any_rotation_and_opacity_one_are_the_isotropic_case(name):
    plain = scene(80)
    quaternions = np.random.default_rng(5).normal(size=(80, 4))
    general = Gaussians(plain.means, np.repeat(plain.scales[:, None], 3, 1), plain.colors, np.ones(80), quaternions)
    error = np.abs(draw(name, general, camera()).color.numpy() - draw(name, plain, camera()).color.numpy()).max(-1)
    assert (error > 1e-4).mean() < 0.005  # as above: two float32 paths to one number
    assert error.max() < 2 / 255


@pytest.mark.parametrize("name", [n for n in NAMES if getattr(RASTERIZERS[n].factory, "differentiable", False)])
def test_gradients_agree_with_the_float64_ones_of_the_torch_rasterizer(name):
    try:
        RASTERIZERS.build(name)
    except UserError as error:
        pytest.skip(str(error))

    def gradients(rasterizer, dtype):
        s = scene(60, seed=4)
        fields = [torch.tensor(a, dtype=dtype, requires_grad=True) for a in (s.means, s.scales, s.colors)]
        picture = RASTERIZERS.build(rasterizer)(Gaussians(*fields), camera())
        weight = torch.linspace(-1, 1, picture.color.numel(), dtype=dtype).view_as(picture.color)
        ((picture.color * weight).sum() + 0.3 * picture.alpha.sum()).backward()
        return [f.grad.double() for f in fields]

    for got, expected in zip(gradients(name, torch.float32), gradients("torch", torch.float64), strict=True):
        assert (got - expected).norm() < 1e-3 * expected.norm()  # the house's bound on float32 gradients


def test_float64_gradients_of_the_torch_rasterizer_agree_with_finite_differences():
    rng = np.random.default_rng(1)
    s = Gaussians(rng.normal(size=(4, 3)) * 0.2, rng.uniform(0.3, 0.4, 4), rng.random((4, 3)), np.full(4, 0.4))
    fields = [torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in (s.means, s.scales, s.colors)]
    opacity = torch.tensor(s.opacities)
    cam = Camera(6, 5, 20.0, 20.0, 3.0, 2.5, look_at((0, 0, -3), (0, 0, 0)))  # everything within every support

    def picture(means, scales, colors):
        return RASTERIZERS.build("torch")(Gaussians(means, scales, colors, opacity), cam).color

    assert torch.autograd.gradcheck(picture, fields, eps=1e-6, atol=1e-5)


def test_numpy_has_no_gradient_and_says_what_has():
    s = scene(3)
    fields = [torch.tensor(a, requires_grad=True) for a in (s.means, s.scales, s.colors)]
    with pytest.raises(UserError, match="rasterizer=torch"):
        RASTERIZERS.build("numpy")(Gaussians(*fields), camera())
