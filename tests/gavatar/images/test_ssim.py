"""SSIM by the kernel is SSIM by its torch reference, with gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gavatar.images.image_quality import ssim, ssim_by_filters
from gavatar_runtime import native_library as nl

needs_kernel = pytest.mark.skipif(not nl.available()[0], reason="the native kernel was not compiled")
INSTRUCTION_SETS = nl.instruction_sets() if nl.available()[0] else []


@pytest.fixture(params=INSTRUCTION_SETS)
def instruction_set(request):
    nl.use_instruction_set(request.param)
    yield request.param
    nl.use_instruction_set(None)


def pictures(shape, seed=0):
    rng = np.random.default_rng(seed)
    y = torch.as_tensor(rng.random(shape), dtype=torch.float32)
    x = (y + torch.as_tensor(rng.normal(0, 0.1, shape), dtype=torch.float32)).clamp(0, 1)
    return x, y


def value_and_gradient(function, x, y, upstream):
    x = x.clone().requires_grad_()
    value = function(x, y)
    (value * upstream.to(value.dtype)).sum().backward()
    return value.detach(), x.grad


# a whole window, rows that are no whole vector, sizes below the window on one side or both, one pixel, one row
SHAPES = [(2, 3, 40, 37), (1, 1, 11, 11), (2, 1, 12, 200), (1, 3, 5, 30), (1, 2, 30, 4), (1, 1, 1, 1), (3, 1, 1, 50)]


@needs_kernel
@pytest.mark.parametrize("shape", SHAPES)
def test_streamed_ssim_is_ssim_by_filters_in_float64(shape, instruction_set):
    x, y = pictures(shape)
    upstream = torch.linspace(0.5, -1, shape[0])
    value, gradient = value_and_gradient(ssim, x, y, upstream)
    expected, expected_gradient = value_and_gradient(ssim_by_filters, x.double(), y.double(), upstream)
    assert value.dtype == gradient.dtype == torch.float32
    # windows of up to 121 float32 terms, and variances as differences of them: some ten roundings of 6e-8
    torch.testing.assert_close(value.double(), expected, atol=1e-6, rtol=0)
    # a single pixel's variance is rounding alone, and counts 1 / C2 = 1111 times in the slope
    scale, rounding = float(expected_gradient.abs().max()), 1e-6 if shape[2:] == (1, 1) else 1e-9
    torch.testing.assert_close(gradient.double(), expected_gradient, atol=5e-6 * scale + rounding, rtol=0)


@needs_kernel
@pytest.mark.parametrize("case", ["flat and equal", "flat", "beyond the range", "black and white"])
def test_streamed_ssim_at_extremes(case):
    x, y = pictures((1, 3, 33, 29))
    if case == "flat and equal":
        x, y = torch.full_like(x, 0.7), torch.full_like(x, 0.7)
    elif case == "flat":
        x, y = torch.full_like(x, 0.2), torch.full_like(x, 0.9)
    elif case == "beyond the range":
        x, y = 5 * x - 2, 3 * y
    else:
        x, y = (x > 0.5).float(), (y > 0.5).float()
    value, gradient = value_and_gradient(ssim, x, y, torch.ones(1))
    expected, expected_gradient = value_and_gradient(ssim_by_filters, x.double(), y.double(), torch.ones(1))
    # flat images that differ by 0.7: E[d^2] - E[d]^2 leaves some 5e-8 of 0.49, and counts 1 / C2 = 1111 times
    torch.testing.assert_close(value.double(), expected, atol=1e-4 if case == "flat" else 2e-6, rtol=0)
    # of flat images float32 and float64 disagree about which side of zero a variance of rounding lies on; its slope is
    # 1 / C2 times the filter's rounding there
    scale = float(expected_gradient.abs().max())
    torch.testing.assert_close(gradient.double(), expected_gradient, atol=1e-5 * scale + 1e-6, rtol=0)


@needs_kernel
def test_a_pixel_that_is_not_finite_spoils_its_plane_and_no_other():
    x, y = pictures((1, 2, 30, 30))
    x[0, 1, 3, 4] = float("nan")
    both = torch.cat([x[:, :1], x[:, 1:]])
    value, gradient = value_and_gradient(ssim, both, torch.cat([y[:, :1], y[:, 1:]]), torch.ones(2))
    assert torch.isfinite(value[0])
    assert torch.isnan(value[1])
    assert torch.isfinite(gradient[0]).all()


@needs_kernel
def test_what_the_kernel_does_not_take_is_computed_all_the_same():
    x, y = pictures((2, 3, 20, 20))
    expected = ssim_by_filters(x.double(), y.double())
    for dtype, tolerance in ((torch.float64, 0), (torch.float16, 2e-2)):  # half has three digits
        torch.testing.assert_close(ssim(x.to(dtype), y.to(dtype)).double(), expected, atol=tolerance, rtol=0)
    y.requires_grad_()
    ssim(x, y).sum().backward()
    assert y.grad.abs().max() > 0
    assert ssim(x, y.detach()).requires_grad is False
    strided = x.permute(0, 1, 3, 2).contiguous().permute(0, 1, 3, 2)
    torch.testing.assert_close(ssim(strided, y.detach()), ssim(x, y.detach()), atol=0, rtol=0)


@needs_kernel
def test_threads_do_not_change_a_bit():
    x, y = pictures((2, 3, 60, 70))
    results = []
    for threads in (1, 3):
        nl.set_threads(threads)
        results.append(value_and_gradient(ssim, x, y, torch.ones(2)))
    nl.set_threads(0)
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))
