"""The player's NumPy rasterizer in evaluation: what the player draws, from torch tensors."""

from __future__ import annotations

import dataclasses

import torch

from gavatar.registry import RASTERIZERS, NoOptions
from gavatar_runtime.camera import Camera
from gavatar_runtime.errors import UserError
from gavatar_runtime.gaussians import Gaussians, Rendering
from gavatar_runtime.rasterizers.numpy import render


@RASTERIZERS.register("numpy", summary="exact, the player's own NumPy rasterizer; evaluation only, no gradients")
class NumpyTensorRasterizer:
    """Exact splatting of torch tensors by `gavatar_runtime.rasterizers.numpy`, in their dtype.

    Follows the contract that `torch` states, without gradients: raises UserError where one would be needed. Tensors of
    another device travel to the CPU and back.
    """

    differentiable = False

    def __init__(self, config: NoOptions | None = None):
        self.config = config

    def __call__(self, gaussians: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0)) -> Rendering:
        background = torch.as_tensor(background)
        inputs = {**vars(gaussians), "background": background}
        for name, value in inputs.items():
            if value is not None and value.requires_grad and torch.is_grad_enabled():
                raise UserError(f"rasterizer=numpy has no gradients and '{name}' asks for one; use rasterizer=torch")
        arrays = {name: None if value is None else value.detach().cpu().numpy() for name, value in inputs.items()}
        background = arrays.pop("background")
        drawn = render(Gaussians(**arrays), camera, background, arrays["means"].dtype.type)
        images = {name: getattr(drawn, name) for name in ("color", "alpha", "depth")}
        device = gaussians.means.device
        return dataclasses.replace(
            drawn, **{name: torch.from_numpy(image).to(device) for name, image in images.items()}
        )
