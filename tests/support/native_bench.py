"""The compiled kernel's images and gradients beside a float64 reference, and how near they must be."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from splat_scenes import FIELDS, as_torch, map_fields

from gavatar_plugins.rasterizers.torch_tiles import TorchRasterizer, TorchRasterizerConfig
from gavatar_runtime import native_library as nl
from gavatar_runtime.values.gaussians import Gaussians

built = pytest.mark.skipif(not nl.available()[0], reason=f"native kernel: {nl.available()[1]}")

# float32 sums of some hundred terms of order one, each with the kernel's relative error of 2e-7
IMAGE = 2e-5
# the same for gradients, whose terms cancel; relative to the gradient's norm
GRADIENT = 1e-4


def images(rendering) -> list[np.ndarray]:
    values = (rendering.color, rendering.alpha, rendering.depth)
    return [x.detach().numpy().copy() if torch.is_tensor(x) else x.copy() for x in values]


def loss_of(rendering, seed: int = 0) -> torch.Tensor:
    """A fixed random linear function of the three images."""
    generator = torch.Generator().manual_seed(seed)
    parts = (rendering.color, rendering.alpha, rendering.depth)
    return sum((torch.rand(x.shape, generator=generator, dtype=torch.float64).to(x.dtype) * x).sum() for x in parts)


def gradients(rasterizer, scene: Gaussians, camera, dtype=torch.float32, background=(0.2, 0.4, 0.9)) -> dict:
    """By each field and the background, of `loss_of`; and the Rendering under 'rendering'."""
    tensors = map_fields(as_torch(scene, dtype), lambda x: x.requires_grad_())
    background = torch.tensor(background, dtype=dtype, requires_grad=True)
    rendering = rasterizer(tensors, camera, background)
    loss_of(rendering).backward()
    named = {name: getattr(tensors, name) for name in FIELDS} | {"background": background}
    return {k: v.grad.numpy() for k, v in named.items() if v is not None} | {"rendering": rendering}


def relative(a, b) -> float:
    return float(np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-12))


def reference() -> TorchRasterizer:
    return TorchRasterizer(TorchRasterizerConfig())


GENERAL = {"isotropic": False, "opacity": True}
