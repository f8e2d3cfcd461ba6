"""PSNR, SSIM, the perceptual distance and LPIPS."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from loss_inputs import write_lpips_weights

from gavatar.images.image_quality import SSIM_C1, SSIM_C2, psnr, ssim
from gavatar.images.lpips import Lpips
from gavatar.images.perceptual import cheaper_pair, perceptual_distance
from gavatar_runtime.errors import UserError


@pytest.fixture(autouse=True)
def _seeded():
    torch.manual_seed(0)


@pytest.fixture(scope="module")
def lpips_files(tmp_path_factory):
    return write_lpips_weights(tmp_path_factory.mktemp("lpips"))


def test_psnr_of_a_known_error():
    x = torch.zeros(2, 3, 4, 4)
    y = torch.stack([torch.full((3, 4, 4), 0.1), torch.zeros(3, 4, 4)])
    assert psnr(x, y)[0].item() == pytest.approx(20, abs=1e-6)
    assert psnr(x, y)[1].item() == math.inf


# ---------------------------------------------------------------- SSIM


def wang(x: np.ndarray, y: np.ndarray, size: int = 11) -> float:
    """Equation 13 of Wang et al. 2004, window by window, on (H, W) float64."""
    k = np.exp(-((np.arange(size) - size // 2) ** 2) / (2 * 1.5**2))
    w = np.outer(k, k) / k.sum() ** 2
    values = []
    for i in range(x.shape[0] - size + 1):
        for j in range(x.shape[1] - size + 1):
            a, b = x[i : i + size, j : j + size], y[i : i + size, j : j + size]
            ma, mb = (w * a).sum(), (w * b).sum()
            va, vb, cov = (w * (a - ma) ** 2).sum(), (w * (b - mb) ** 2).sum(), (w * (a - ma) * (b - mb)).sum()
            top = (2 * ma * mb + SSIM_C1) * (2 * cov + SSIM_C2)
            values.append(top / ((ma**2 + mb**2 + SSIM_C1) * (va + vb + SSIM_C2)))
    return float(np.mean(values))


@pytest.mark.parametrize("size", [(11, 11), (13, 20)])
def test_ssim_is_wangs_formula(size):
    rng = np.random.default_rng(0)
    x, y = rng.random(size), rng.random(size)
    for a, b in ((x, y), (x, 1 - x), (x, np.clip(x + 0.05 * y, 0, 1))):
        found = ssim(torch.from_numpy(a)[None, None], torch.from_numpy(b)[None, None]).item()
        assert found == pytest.approx(wang(a, b), abs=1e-12)  # both float64


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("contrast", [0.0, 1e-4, 1e-2])
def test_ssim_of_nearly_constant_images_survives_float32(level, contrast):
    g = torch.Generator().manual_seed(0)
    x = level + contrast * torch.randn(1, 1, 24, 24, generator=g, dtype=torch.float64)
    y = level + 1e-3 + contrast * torch.randn(1, 1, 24, 24, generator=g, dtype=torch.float64)
    # E[x^2] - E[x]^2 in float32 is off by 1e-7, which against C2 = 9e-4 would be 1e-4
    assert ssim(x.float(), y.float()).item() == pytest.approx(wang(x[0, 0].numpy(), y[0, 0].numpy()), abs=2e-6)


def test_ssim_of_flat_images_apart_survives_float32():
    x, y = torch.full((1, 3, 32, 32), 0.9), torch.full((1, 3, 32, 32), 0.3)
    # without centring the variance of x - y is 1e-7 instead of 0, and the result off by 1e-4
    assert ssim(x, y).item() == pytest.approx(ssim(x.double(), y.double()).item(), abs=1e-6)


def test_ssim_of_a_person_on_white_survives_float32():
    x = torch.ones(1, 3, 48, 48, dtype=torch.float64)
    x[:, :, 12:40, 20:30] = 0.3
    y = x.clone()
    y[:, :, 13:41, 20:30] = 0.32
    assert ssim(x.float(), y.float()).item() == pytest.approx(ssim(x, y).item(), abs=2e-6)


def test_ssim_of_identical_images_is_one_and_of_half_precision_finite():
    x = torch.rand(2, 3, 20, 20)
    assert torch.equal(ssim(x, x), torch.ones(2))
    y = torch.rand(2, 3, 20, 20)
    # bfloat16 keeps 8 bits of the pixels: 0.004 each
    assert torch.allclose(ssim(x.bfloat16(), y.bfloat16()), ssim(x, y), atol=0.02)


def test_ssim_scores_each_image_by_itself_and_is_symmetric():
    x, y = torch.rand(3, 3, 16, 19), torch.rand(3, 3, 16, 19)
    each = torch.cat([ssim(a[None], b[None]) for a, b in zip(x, y, strict=True)])
    assert torch.allclose(ssim(x, y), each, atol=1e-6)
    assert torch.allclose(ssim(x, y), ssim(y, x), atol=1e-6)


def test_ssim_has_the_right_gradient_to_second_order():
    x = torch.rand(1, 1, 6, 4, dtype=torch.float64, requires_grad=True)
    y = torch.rand(1, 1, 6, 4, dtype=torch.float64)
    assert torch.autograd.gradcheck(ssim, (x, y))
    assert torch.autograd.gradgradcheck(lambda a: ssim(a, y), (x,))


# ---------------------------------------------------------------- perceptual distances


def test_perceptual_distance_grows_with_the_damage():
    x = torch.nn.functional.interpolate(torch.rand(1, 3, 8, 8), size=64, mode="bicubic").clamp(0, 1)
    noise = torch.randn(1, 3, 64, 64)
    distances = [perceptual_distance((x + a * noise).clamp(0, 1), x).item() for a in (0, 0.02, 0.05, 0.2)]
    assert distances == sorted(distances)
    assert distances[0] == 0
    assert 0.05 < distances[-1] < 2


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_perceptual_gradient_of_a_flat_image_is_finite(value):
    x = torch.full((1, 3, 32, 32), value, requires_grad=True)
    perceptual_distance(x, torch.rand(1, 3, 32, 32), 5).sum().backward()
    assert torch.isfinite(x.grad).all()
    assert x.grad.abs().max() < 10  # a vanishing feature vector does not blow it up


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_lpips_gradient_of_a_flat_image_is_finite(lpips_files, net):
    x = torch.full((1, 3, 32, 32), 0.5, requires_grad=True)
    Lpips(net, *map(str, lpips_files[net]))(x, torch.rand(1, 3, 32, 32)).sum().backward()
    assert torch.isfinite(x.grad).all()


def test_lpips_gradient_is_finite_where_features_vanish(lpips_files):
    network = Lpips("alex", *map(str, lpips_files["alex"]))
    network.slices[0][0].weight.fill_(0)
    network.slices[0][0].bias.fill_(1e-25)  # alive for the ReLU, but its square underflows in float32
    x = torch.rand(1, 3, 32, 32, requires_grad=True)
    network(x, torch.rand(1, 3, 32, 32)).sum().backward()
    assert torch.isfinite(x.grad).all()


def test_the_reference_gets_no_gradient(lpips_files):
    x, y = torch.rand(1, 3, 32, 32, requires_grad=True), torch.rand(1, 3, 32, 32, requires_grad=True)
    (perceptual_distance(x, y, 2) + Lpips("alex", *map(str, lpips_files["alex"]))(x, y)).sum().backward()
    assert y.grad is None


def test_what_evaluation_loaded_in_inference_mode_can_be_trained_through():
    from gavatar.images import image_quality, perceptual

    image_quality._gaussian.cache_clear()
    perceptual._features.cache_clear()
    x, y = torch.rand(1, 3, 16, 16, requires_grad=True), torch.rand(1, 3, 16, 16)
    with torch.inference_mode():
        ssim(x, y), perceptual_distance(x, y, 2)
    (ssim(x, y) + perceptual_distance(x, y, 2)).sum().backward()
    assert torch.isfinite(x.grad).all()


def test_a_crop_lies_on_the_person_and_repeats_with_the_seed():
    image = torch.arange(64.0 * 48).view(1, 1, 64, 48).expand(1, 3, 64, 48)
    mask = torch.zeros(1, 64, 48)
    mask[:, 30:60, 5:40] = 1
    corners = set()
    for seed in range(20):
        a, b = cheaper_pair(image, image, mask, crop=16, max_size=0, seed=seed)
        assert a.shape == (1, 3, 16, 16)
        assert torch.equal(a, b)
        assert torch.equal(a, cheaper_pair(image, image, mask, 16, 0, seed)[0])
        row, column = divmod(int(a[0, 0, 0, 0]), 48)
        assert 30 <= row <= 44
        assert 5 <= column <= 24
        corners.add((row, column))
    assert len(corners) > 10


@pytest.mark.parametrize("mask", [torch.zeros(1, 20, 30), torch.ones(1, 20, 30), torch.eye(20, 30)[None]])
def test_a_crop_larger_than_the_image_or_off_the_person_stays_inside(mask):
    image = torch.rand(1, 3, 20, 30)
    assert cheaper_pair(image, image, mask, crop=25, max_size=0, seed=1)[0].shape == (1, 3, 20, 25)
    assert cheaper_pair(image, image, mask, crop=64, max_size=0, seed=1)[0] is image


def test_a_crop_larger_than_the_person_has_the_person_in_the_middle():
    mask = torch.zeros(1, 40, 60)
    mask[:, 10:31, 30:35] = 1
    crop, _ = cheaper_pair(mask[:, None].expand(1, 3, 40, 60), mask[:, None], mask, crop=25, max_size=0, seed=0)
    assert crop[0, 0].any(0).nonzero().flatten().tolist() == [10, 11, 12, 13, 14]
    assert crop[0, 0].any(1).sum() == 21


def test_max_size_averages_down_and_never_up():
    image = torch.rand(2, 3, 40, 20)
    small, _ = cheaper_pair(image, image, image[:, 0], 0, 10, 0)
    assert small.shape == (2, 3, 10, 5)
    assert torch.allclose(small, image.unflatten(3, (5, 4)).unflatten(2, (10, 4)).mean((3, 5)), atol=1e-6)
    assert cheaper_pair(image, image, image[:, 0], 0, 100, 0)[0] is image


def test_missing_lpips_weights_are_said_in_one_sentence(tmp_path, monkeypatch, lpips_files):
    monkeypatch.delenv("GAVATAR_LPIPS_BACKBONE", raising=False)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    with pytest.raises(UserError, match=r"alexnet-owt-7be5be79\.pth.*GAVATAR_LPIPS_BACKBONE"):
        Lpips()
    with pytest.raises(UserError, match="there is no file"):
        Lpips(backbone=str(tmp_path / "absent.pth"))
    with pytest.raises(UserError, match="did you mean 'vgg'"):
        Lpips("vgg16")
    backbone, linear = lpips_files["alex"]
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UserError, match="pip install --no-deps lpips"):
        Lpips(backbone=str(backbone))
    with pytest.raises(UserError, match="not the weights file"):
        Lpips("alex", str(lpips_files["vgg"][0]), str(linear))
    (tmp_path / "broken.pth").write_bytes(b"not a checkpoint")
    with pytest.raises(UserError, match="cannot be read"):
        Lpips("alex", str(tmp_path / "broken.pth"), str(linear))
    monkeypatch.setenv("GAVATAR_LPIPS_BACKBONE", str(backbone.parent))  # a folder will do
    assert Lpips("alex", linear=str(linear)).title == "LPIPS 0.1 (AlexNet)"


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    ("size", "window"), [((40, 33), (11, 11)), ((11, 11), (11, 11)), ((1, 30), (1, 11)), ((3, 2), (3, 1))]
)
def test_the_fast_ssim_filter_is_the_convolution(dtype, size, window):
    from gavatar.images.image_quality import filter_convolved, filter_stacked

    x = torch.rand(2, 3, *size, dtype=dtype, generator=torch.Generator().manual_seed(0))
    fast, plain = filter_stacked(x, *window), filter_convolved(x, *window)
    assert fast.shape == plain.shape
    # sums of 121 products in another order
    assert torch.allclose(fast, plain, rtol=0, atol=20 * torch.finfo(dtype).eps)
