"""The player's NumPy rasterizer, for evaluation."""

from __future__ import annotations

import torch

from gavatar.protocols import Background, Rasterizer
from gavatar.registry import RASTERIZERS, NoOptions, RasterizerTraits
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.rasterizers.numpy import render
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering

from .torch_projection import check_dtype


@RASTERIZERS.register(
    "numpy",
    summary="the player's NumPy reference, forward only (for evaluation)",
    traits=RasterizerTraits(differentiable=False, devices=("cpu",)),
)
class NumpyTensors(Rasterizer):
    """Adapts the player's reference to CPU tensors. Raises UserError where a gradient would be needed."""

    def __init__(self, config: NoOptions | None = None):
        self.config = config

    def __call__(self, gaussians: Gaussians, camera: Camera, background: Background = (1.0, 1.0, 1.0)) -> Rendering:
        check_dtype(gaussians)
        fields = [gaussians.means, gaussians.scales, gaussians.colors, gaussians.opacities, gaussians.quaternions]
        if torch.is_grad_enabled() and any(f is not None and f.requires_grad for f in fields):
            raise UserError("rasterizer=numpy has no gradients: train with rasterizer=auto or rasterizer=torch")
        arrays = Gaussians(*(None if f is None else f.detach().cpu().numpy() for f in fields))
        dtype = arrays.means.dtype.type
        out = render(arrays, camera, torch.as_tensor(background).detach().cpu().numpy(), dtype)
        color, alpha, depth = (torch.from_numpy(a) for a in (out.color, out.alpha, out.depth))
        return Rendering(color, alpha, depth, out.dropped)
