"""Rewrites of networks that change nothing of what they compute."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from gavatar.avatar.uv_sampling import bilinear, sample_uv
from gavatar.export.onnx_graphs import fold_batchnorm, subpixel


def test_a_pixel_shuffle_is_the_transposed_convolution():
    torch.manual_seed(0)
    for size, bias in ((1, True), (2, False), (7, True)):
        net = nn.Sequential(nn.ConvTranspose2d(3, 5, 4, 2, 1, bias=bias), nn.ReLU())
        x = torch.randn(2, 3, size, size)
        assert not any(isinstance(m, nn.ConvTranspose2d) for m in subpixel(net).modules())
        assert torch.allclose(subpixel(net)(x), net(x), atol=1e-6)
    other = nn.Sequential(nn.ConvTranspose2d(3, 5, 3, 2, 1))
    assert isinstance(subpixel(other)[0], nn.ConvTranspose2d)  # another kernel is left as it is


def test_four_gathered_texels_are_the_bilinear_sample():
    rng = np.random.default_rng(0)
    uv = np.concatenate([rng.random((50, 2)), [[0, 0], [1, 1], [0, 1], [0.5, 0.5]]]).astype(np.float32)
    maps = torch.from_numpy(rng.normal(size=(1, 3, 16, 16)).astype(np.float32))
    corner, weight = bilinear(uv, 16)
    texels = maps.reshape(3, -1).T.numpy()
    got = (texels[corner] * weight[..., None]).sum(1)
    np.testing.assert_allclose(got, sample_uv(maps, torch.from_numpy(uv))[0].numpy(), atol=1e-5)


def test_folding_batchnorm_changes_nothing_that_is_evaluated():
    torch.manual_seed(0)
    up = nn.ConvTranspose2d(4, 5, 4, 2, 1)
    conv = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.ReLU(), up, nn.BatchNorm2d(5, affine=False))
    linear = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4), nn.Softplus())
    for net, x in ((conv, torch.randn(2, 3, 8, 8)), (linear, torch.randn(9, 3))):
        for _ in range(3):
            net(x * 2 + 1)  # running statistics away from their start
        net.eval()
        folded = fold_batchnorm(net)
        assert not any(isinstance(m, (nn.BatchNorm1d, nn.BatchNorm2d)) for m in folded.modules())
        # a product of float32 numbers taken in another order
        assert torch.allclose(folded(x), net(x), atol=1e-5)
        assert any(isinstance(m, (nn.BatchNorm1d, nn.BatchNorm2d)) for m in net.modules())
