"""Which Gaussians a picture shows, told by the rasterizer's own blending weights."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch
from torch import Tensor

from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering


def pixel_weights(
    rasterize: Callable[..., Rendering], gaussians: Gaussians, camera: Camera, mask: Tensor | None = None
) -> Tensor:
    """(N,) pixels of the picture, inside `mask` (H, W) if given, that each Gaussian makes up.

    A pixel is the sum of the Gaussians' colours times their blending weights, so the gradient of `sum(pixel * mask)`
    by a Gaussian's colour is the sum of its weights.
    """
    colors = torch.zeros_like(gaussians.means, requires_grad=True)
    background = gaussians.means.new_zeros(3)
    picture = rasterize(dataclasses.replace(gaussians, colors=colors), camera, background).color[..., 0]
    total = (picture if mask is None else picture * mask).sum()
    return torch.autograd.grad(total, colors)[0][:, 0]
