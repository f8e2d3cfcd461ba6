"""The best rasterizer for the tensors at hand."""

from __future__ import annotations

import logging

import torch

from gavatar.registry import RASTERIZERS, NoOptions
from gavatar_runtime.camera import Camera
from gavatar_runtime.errors import UserError
from gavatar_runtime.gaussians import Gaussians, Rendering

log = logging.getLogger("gavatar.rasterizers")


@RASTERIZERS.register("auto", summary="native for float32 tensors on the CPU where it is compiled, else torch")
class AutoRasterizer:
    """Chooses at each call by device and dtype and logs a choice when it is first made. Options of the chosen one are
    its defaults; name it to set them."""

    differentiable = True

    def __init__(self, config: NoOptions | None = None):
        self._built: dict[str, object] = {}

    def __call__(self, gaussians: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0)) -> Rendering:
        means = gaussians.means
        native = means.device.type == "cpu" and means.dtype == torch.float32
        return self._choose("native" if native else "torch")(gaussians, camera, background)

    def _choose(self, name: str):
        if name not in self._built:
            try:
                self._built[name] = RASTERIZERS.build(name)
                log.info("rasterizer auto: %s", name)
            except UserError as error:
                if name == "torch":
                    raise
                log.warning("rasterizer auto: torch, because %s", error)
                self._built[name] = self._choose("torch")
        return self._built[name]
