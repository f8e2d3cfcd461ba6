"""A stand-in for a rasterizer, so simple that its image is known."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.render.rasterizers import Rasterizer
from gavatar_runtime.values.gaussians import Rendering


class Dots(Rasterizer):
    """The pixel of each mean takes its colour. Keeps the cameras that it was given."""

    def __init__(self, config=None, fail_at=None):
        self.cameras, self.fail_at, self.stage_seconds = [], fail_at, {}

    def render(self, gaussians, camera, background):
        if self.fail_at == len(self.cameras):
            raise RuntimeError("out of colour")
        self.cameras.append(camera)
        image = np.tile(np.float32(background), (camera.height, camera.width, 1))
        x, y, z = camera.project(gaussians.means).T
        inside = (z > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        image[y[inside].astype(int), x[inside].astype(int)] = gaussians.colors[inside]
        self.stage_seconds = {"project": 0.25, "sort": 0.25, "blend": 0.5}
        return Rendering(image, np.ones(image.shape[:2]), np.ones(image.shape[:2]))
