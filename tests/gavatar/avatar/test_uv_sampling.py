"""Sampling of UV maps by the kernel is grid sampling, with gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gavatar.avatar.uv_sampling import Sampler, bilinear, sample_uv
from gavatar_runtime import native_library as nl

needs_kernel = pytest.mark.skipif(not nl.available()[0], reason="the native kernel was not compiled")
INSTRUCTION_SETS = nl.instruction_sets() if nl.available()[0] else []


@pytest.fixture(params=INSTRUCTION_SETS)
def instruction_set(request):
    nl.use_instruction_set(request.param)
    yield request.param
    nl.use_instruction_set(None)


@needs_kernel
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize(("batch", "channels", "size", "count"), [
    (1, 32, 16, 3000), (3, 64, 8, 100), (2, 7, 5, 50), (1, 1, 2, 1), (1, 70, 9, 0), (2, 3, 1, 10)
])  # fmt: skip
def test_sampling_by_a_sparse_product_is_grid_sampling(batch, channels, size, count, layout, instruction_set):
    rng = np.random.default_rng(1)
    uv = rng.random((count, 2)).astype(np.float32)
    uv[: min(4, count)] = np.array([[0, 0], [1, 1], [0.5, 1], [1.2, -0.3]], np.float32)[: min(4, count)]
    maps = torch.as_tensor(rng.normal(0, 1, (batch, channels, size, size)), dtype=torch.float32)
    maps = maps.contiguous(memory_format=layout).requires_grad_()
    upstream = torch.as_tensor(rng.normal(0, 1, (batch, count, channels)), dtype=torch.float32)
    out = Sampler(uv)(maps, torch.as_tensor(uv))
    out.backward(upstream)
    exact = maps.detach().double().requires_grad_()
    expected = sample_uv(exact, torch.as_tensor(uv, dtype=torch.float64))
    expected.backward(upstream.double())
    # weights are rounded to float32, and those below 1e-6 left out; a texel gathers from count / size^2 points
    torch.testing.assert_close(out.double(), expected, atol=2e-5, rtol=0)
    torch.testing.assert_close(maps.grad.double(), exact.grad, atol=2e-5 * (1 + count / size**2), rtol=0)


@needs_kernel
def test_an_atlas_of_the_maps_size_is_read_texel_by_texel():
    size = 12
    centres = (np.stack(np.meshgrid(np.arange(size), np.arange(size)), -1).reshape(-1, 2) + 0.5) / size
    uv = centres.astype(np.float32)
    maps = torch.randn(1, 4, size, size)
    out = Sampler(uv)(maps, torch.as_tensor(uv))
    # centres in float32 lie up to 1e-7 of the map's side off
    torch.testing.assert_close(out[0], maps[0].flatten(1).T, atol=2e-5, rtol=0)
    assert (bilinear(uv, size)[1] > 0.99).any(1).all()


@needs_kernel
def test_threads_do_not_change_a_bit_of_the_samples_gradient():
    uv = np.random.default_rng(0).random((5000, 2), np.float32)
    maps, sampler = torch.randn(1, 20, 16, 16), Sampler(uv)
    gradients = []
    for threads in (1, 3):
        nl.set_threads(threads)
        m = maps.clone().requires_grad_()
        sampler(m, torch.as_tensor(uv)).square().sum().backward()
        gradients.append(m.grad)
    nl.set_threads(0)
    assert torch.equal(*gradients)
