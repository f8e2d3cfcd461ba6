"""The best rasterizer for the tensors at hand."""

from __future__ import annotations

import logging

import torch

from gavatar.protocols import Background, Rasterizer
from gavatar.registry import RASTERIZERS, NoOptions
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering

log = logging.getLogger("gavatar.rasterizers")

# what serves float32 tensors on a device, the best first; plain torch takes everything
BY_DEVICE = {"cpu": ("native",), "cuda": ("gsplat",)}


@RASTERIZERS.register(
    "auto",
    summary="the best for the tensors: native on the CPU, gsplat on CUDA, torch where these are not to be had",
    default=True,
)
class AutoRasterizer(Rasterizer):
    """Chooses at each call by device and dtype and logs a choice when it is first made. Options of the chosen one are
    its defaults; name it to set them."""

    def __init__(self, config: NoOptions | None = None):
        self._chosen: dict[tuple[str, ...], Rasterizer] = {}

    def __call__(self, gaussians: Gaussians, camera: Camera, background: Background = (1.0, 1.0, 1.0)) -> Rendering:
        means = gaussians.means
        names = BY_DEVICE.get(means.device.type, ()) if means.dtype == torch.float32 else ()
        if names not in self._chosen:
            self._chosen[names] = _first(names)
        return self._chosen[names](gaussians, camera, background)


def _first(names: tuple[str, ...]) -> Rasterizer:
    """The first of `names` that can be built here, else torch."""
    for name in names:
        try:
            rasterizer = RASTERIZERS.build(name)
        except UserError as error:
            log.warning("rasterizer auto: not %s, because %s", name, error)
        else:
            log.info("rasterizer auto: %s", name)
            return rasterizer
    log.info("rasterizer auto: torch")
    return RASTERIZERS.build("torch")
