"""How alike two images are: PSNR and SSIM in torch, one implementation for training and evaluation."""

from __future__ import annotations

import functools
import math

import torch
import torch.nn.functional as F
from torch import Tensor

SSIM_WINDOW = 11
SSIM_SIGMA = 1.5
SSIM_C1 = 0.01**2  # (K1 L)^2 and (K2 L)^2 with L = 1, the range of the data
SSIM_C2 = 0.03**2


def psnr(image: Tensor, reference: Tensor) -> Tensor:
    """(B,) peak signal-to-noise ratio in dB of images (B, C, H, W) in [0, 1]; infinite where they are identical."""
    mse = (image.double() - reference.double()).square().flatten(1).mean(1)
    return -10 * torch.log10(mse)


def ssim(image: Tensor, reference: Tensor) -> Tensor:
    """(B,) structural similarity of images (B, C, H, W) in [0, 1]; 1 where they are identical.

    Wang et al. 2004: Gaussian window of 11 pixels and sigma 1.5, K1 = 0.01, K2 = 0.03, population covariance; mean
    over channels and over the positions where the whole window lies in the image. An image smaller than the window
    is judged with the largest odd window that fits. Half precision is computed in float32.
    """
    if image.dtype not in (torch.float32, torch.float64):
        image, reference = image.float(), reference.float()
    # SSIM = (1 - mean_d^2 / (mean_x^2 + mean_y^2 + C1)) (1 - var_d / (var_x + var_y + C2)) with d = x - y: the same
    # number as Wang's quotient, one filter fewer, and no cancellation where the images agree. Variances by
    # E[x^2] - E[x]^2 are taken of centred data, since float32 loses them beside a large mean.
    center = ((image + reference) / 2).mean((-2, -1), keepdim=True).detach()
    x, y = image - center, reference - center
    d = x - y
    filtered = _gaussian_filter(torch.cat([x, y, x * x + y * y, d * d]))
    mean_x, mean_y, power, power_d = filtered.chunk(4)
    mean_d = mean_x - mean_y
    var_sum = (power - mean_x * mean_x - mean_y * mean_y).clamp(min=0)
    var_d = (power_d - mean_d * mean_d).clamp(min=0)
    luminance = 1 - mean_d * mean_d / ((mean_x + center).square() + (mean_y + center).square() + SSIM_C1)
    structure = 1 - var_d / (var_sum + SSIM_C2)
    return (luminance * structure).flatten(1).mean(1)


@functools.lru_cache(maxsize=16)
def _gaussian(size: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """(size,) samples of a Gaussian of sigma 1.5 about the middle, summing to one."""
    x = torch.arange(size, dtype=torch.float64) - (size - 1) / 2
    kernel = torch.exp(-x * x / (2 * SSIM_SIGMA**2))
    return (kernel / kernel.sum()).to(device, dtype)


def _gaussian_filter(x: Tensor) -> Tensor:
    """(B, C, H, W) -> (B, C, H - h + 1, W - w + 1), each channel smoothed where the window fits."""
    B, C, H, W = x.shape
    x = x.reshape(B * C, 1, H, W)
    for axis, length in ((2, H), (3, W)):
        size = min(SSIM_WINDOW, length - (length + 1) % 2)
        kernel = _gaussian(size, x.dtype, x.device)
        x = F.conv2d(x, kernel.view(1, 1, -1, 1) if axis == 2 else kernel.view(1, 1, 1, -1))
    return x.view(B, C, *x.shape[2:])


def mean_psnr(values, cap: float = 100.0) -> float:
    """The mean of PSNR values in dB, each clipped at `cap` so that one identical frame does not make it infinite."""
    values = [min(float(v), cap) for v in values]
    return sum(values) / len(values) if values else math.nan
