"""Losses and metrics of images of one colour: known values, finite gradients."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional as F

from gavatar.images.image_quality import mean_psnr, psnr, ssim, ssim_by_filters
from gavatar.images.perceptual import perceptual_distance

C1 = 0.01**2  # of SSIM (Wang et al. 2004), for images in [0, 1]


def flat(value: float, size: tuple[int, int] = (24, 30), dtype=torch.float32) -> torch.Tensor:
    return torch.full((1, 3, *size), value, dtype=dtype)


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.25, 0.75), (0.5, 0.5 + 1e-6)])
@pytest.mark.parametrize("size", [(24, 30), (1, 1)])
def test_structure_of_two_flat_images_is_the_term_of_their_means(a, b, size):
    image, reference = flat(a, size).requires_grad_(), flat(b, size)
    expected = (2 * a * b + C1) / (a * a + b * b + C1)
    for measure in (ssim, ssim_by_filters):
        value = measure(image, reference)
        # 1e-6: a few roundings of float32; variances of flat images are zero up to those
        assert float(value.detach().mean()) == pytest.approx(expected, abs=1e-6)
        (gradient,) = torch.autograd.grad(value.sum(), image)
        assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("a", [0.0, 0.5, 1.0])
def test_equal_flat_images_have_no_error(a):
    assert float(psnr(flat(a), flat(a))) == float("inf")
    assert mean_psnr([float("inf"), 20.0]) == 60.0  # capped at 100
    assert float(F.l1_loss(flat(a), flat(a))) == 0


def test_black_against_white_is_zero_decibels():
    assert float(psnr(flat(0.0), flat(1.0))) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("a", [0.0, 0.5, 1.0])
def test_the_perceptual_distance_of_flat_images(a):
    image = flat(a, (64, 64)).requires_grad_()
    value = perceptual_distance(image, flat(a, (64, 64)))
    assert float(value.detach()) == pytest.approx(0.0, abs=1e-7)
    (gradient,) = torch.autograd.grad(value.sum(), image)
    assert torch.isfinite(gradient).all()
    assert float(perceptual_distance(flat(a, (64, 64)), flat(abs(1 - a) + 0.1, (64, 64)))) > 0
