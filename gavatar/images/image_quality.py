"""How alike two images are: PSNR and SSIM in torch, one implementation for training and evaluation."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from typing import Any

import cv2
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from gavatar_runtime import native_library as nl

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
    if _can_stream(image, reference):
        return _StreamedSsim.apply(image, reference)
    return ssim_by_filters(image, reference)


def ssim_by_filters(image: Tensor, reference: Tensor) -> Tensor:
    """`ssim` in torch, on any device, of float32 or float64, differentiable in both images as often as one likes."""
    # SSIM = (1 - mean_d^2 / (mean_x^2 + mean_y^2 + C1)) (1 - var_d / (var_x + var_y + C2)) with d = x - y: the same
    # number as Wang's quotient, one filter fewer, and no cancellation where the images agree. Variances by
    # E[x^2] - E[x]^2 are taken of centred data, since float32 loses them beside a large mean.
    center = ((image + reference) / 2).mean((-2, -1), keepdim=True).detach()
    x, y = image - center, reference - center
    d = x - y
    filtered = _GaussianFilter.apply(torch.cat([x, y, x * x + y * y, d * d]))
    mean_x, mean_y, power, power_d = filtered.chunk(4)
    mean_d = mean_x - mean_y
    var_sum = (power - mean_x * mean_x - mean_y * mean_y).clamp(min=0)
    var_d = (power_d - mean_d * mean_d).clamp(min=0)
    luminance = 1 - mean_d * mean_d / ((mean_x + center).square() + (mean_y + center).square() + SSIM_C1)
    structure = 1 - var_d / (var_sum + SSIM_C2)
    return (luminance * structure).flatten(1).mean(1)


def _can_stream(image: Tensor, reference: Tensor) -> bool:
    """Whether the kernel takes these images: float32 on the CPU, some pixels, no gradient by the reference wanted."""
    return (
        image.dtype == reference.dtype == torch.float32
        and image.device.type == reference.device.type == "cpu"
        and image.shape == reference.shape
        and image.numel() > 0
        and not (reference.requires_grad and torch.is_grad_enabled())
        and nl.available()[0]
    )


class _StreamedSsim(torch.autograd.Function):
    """`ssim_by_filters` by the compiled kernel, which finds value and gradient in one pass over the images."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, reference: Tensor) -> Tensor:
        image, reference = image.contiguous(), reference.contiguous()
        B, C, H, W = image.shape
        column, line = (_gaussian(min(SSIM_WINDOW, n - (n + 1) % 2), image.dtype, image.device) for n in (H, W))
        values = torch.empty(B, C, dtype=torch.float64)
        gradient = torch.empty_like(image) if ctx.needs_input_grad[0] else None
        arrays = (column, line, image, reference, values)
        pointers = (*(x.data_ptr() for x in arrays), None if gradient is None else gradient.data_ptr())
        nl.check(nl.library().gv_ssim(B * C, H, W, len(column), len(line), *pointers))
        ctx.save_for_backward(gradient)
        return values.mean(1).float()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * (upstream / gradient.shape[1]).view(-1, 1, 1, 1), None


@functools.lru_cache(maxsize=16)
def _gaussian(size: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """(size,) samples of a Gaussian of sigma 1.5 about the middle, summing to one."""
    # cached beyond the caller's mode: tensors made under inference_mode could never be trained through
    with torch.inference_mode(False):
        x = torch.arange(size, dtype=torch.float64) - (size - 1) / 2
        kernel = torch.exp(-x * x / (2 * SSIM_SIGMA**2))
        return (kernel / kernel.sum()).to(device, dtype)


class _GaussianFilter(torch.autograd.Function):
    """(B, C, H, W) -> (B, C, H - h + 1, W - w + 1), each channel smoothed where the window fits.

    Autograd's own backward of a depthwise convolution also prepares weight gradients and runs several times slower
    on a CPU. The window is symmetric, so the adjoint is the same filter on the zero-padded gradient.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.sizes = tuple(min(SSIM_WINDOW, n - (n + 1) % 2) for n in x.shape[-2:])
        return _filter(x, *ctx.sizes)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        h, w = ctx.sizes
        return _filter(F.pad(gradient, (w - 1, w - 1, h - 1, h - 1)), h, w)


def _filter(x: Tensor, h: int, w: int) -> Tensor:
    """Valid separable Gaussian filter of h x w pixels (odd), by the fastest means for the tensor at hand."""
    differentiated = torch.is_grad_enabled() and x.requires_grad  # only in a second-order backward
    fast = x.device.type == "cpu" and x.numel() and not differentiated
    return filter_stacked(x, h, w) if fast else filter_convolved(x, h, w)


def filter_stacked(x: Tensor, h: int, w: int) -> Tensor:
    """`filter_convolved` by OpenCV, some three times faster on a CPU: all channels under one another as one image, and
    the rows that mix two of them cut away."""
    B, C, H, W = x.shape
    stack = x.detach().contiguous().numpy().reshape(B * C * H, W)
    rows, columns = (_gaussian(n, x.dtype, x.device).numpy() for n in (h, w))
    y = cv2.sepFilter2D(stack, -1, columns, rows, borderType=cv2.BORDER_CONSTANT)
    return torch.from_numpy(y).view(B, C, H, W)[..., h // 2 : H - h // 2, w // 2 : W - w // 2]


def filter_convolved(x: Tensor, h: int, w: int) -> Tensor:
    """(B, C, H, W) -> (B, C, H - h + 1, W - w + 1): a Gaussian of h x w pixels (odd) where it fits. The reference, on
    any device and with gradients."""
    channels = x.shape[0] * x.shape[1]
    rows, columns = _gaussian(h, x.dtype, x.device), _gaussian(w, x.dtype, x.device)
    # channels last is the layout in which a depthwise convolution is vectorised
    y = x.reshape(1, channels, *x.shape[2:]).contiguous(memory_format=torch.channels_last)
    y = F.conv2d(y, rows.view(1, 1, -1, 1).expand(channels, 1, h, 1), groups=channels)
    y = F.conv2d(y, columns.view(1, 1, 1, -1).expand(channels, 1, 1, w), groups=channels)
    return y.reshape(*x.shape[:2], *y.shape[2:])


def mean_psnr(values: Iterable[float], cap: float = 100.0) -> float:
    """The mean of PSNR values in dB, each clipped at `cap` so that one identical frame does not make it infinite."""
    values = [min(float(v), cap) for v in values]
    return sum(values) / len(values) if values else math.nan
