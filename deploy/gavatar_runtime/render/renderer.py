"""An avatar and a rasterizer together: a pose and a camera in, an image out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..avatar.played import PlayedAvatar
from ..errors import WrongValue
from ..values.camera import Camera
from ..values.gaussians import Gaussians, Rendering
from .choice import build_rasterizer
from .rasterizers import WHITE, Rasterizer
from .widening import as_trained


class Renderer:
    """Draws an avatar as it was trained to be drawn.

    avatar: `Avatar` or `AdaptiveAvatar`. rasterizer: the name of one, `auto` for the fastest that is there, which is
    built with the switches in the manifest of the avatar's bundle; or a `Rasterizer`, used as it is. options, threads:
    of the one that is built (`choice.build_rasterizer`).
    The arrays of what it returns are filled again by later calls: copy what is to be kept.
    Raises UserError for an unknown name or option, and for options of a rasterizer that is already built.
    """

    def __init__(
        self,
        avatar: PlayedAvatar,
        rasterizer: str | Rasterizer = "auto",
        *,
        options: Mapping[str, Any] | None = None,
        threads: int | None = None,
    ):
        if isinstance(rasterizer, str):
            trained = avatar.bundle.manifest.rasterizer
            rasterizer = build_rasterizer(rasterizer, options, threads=threads, trained=trained)
        elif options or threads is not None:
            raise WrongValue(f"{type(rasterizer).__name__} is built already: options and threads belong to its making")
        self.avatar = avatar
        self.rasterizer: Rasterizer = rasterizer

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Wall seconds of each stage of the last frame: the avatar's, then the rasterizer's."""
        return {**self.avatar.stage_seconds, **self.rasterizer.stage_seconds}

    def draw(
        self,
        pose: np.ndarray,
        camera: Camera,
        *,
        trans: np.ndarray | None = None,
        expression: np.ndarray | None = None,
        background: Sequence[float] = WHITE,
    ) -> Rendering:
        """The avatar in one pose, float32. pose, trans, expression: see `Avatar.gaussians`. background: (3,) sRGB in
        [0, 1]."""
        return self.rasterize(self.gaussians(pose, trans, expression, camera=camera), camera, background)

    def gaussians(
        self,
        pose: np.ndarray,
        trans: np.ndarray | None = None,
        expression: np.ndarray | None = None,
        *,
        camera: Camera,
    ) -> Gaussians:
        """The first half of `draw`: posed, with what the rasterizer wants, and wider where the camera's pixels are
        finer than those of the training images. It may run while another thread draws the Gaussians of the call
        before."""
        normals = self.rasterizer.wants_normals
        gaussians = self.avatar.gaussians(pose, trans, expression, camera=camera, normals=normals, copy=False)
        return as_trained(gaussians, camera, self.avatar.pixel)

    def rasterize(self, gaussians: Gaussians, camera: Camera, background: Sequence[float] = WHITE) -> Rendering:
        """The second half of `draw`: what `gaussians` gave for this camera as an image."""
        return self.rasterizer.render(gaussians, camera, background)

    def rasterize_uint8(self, gaussians: Gaussians, camera: Camera, background: Sequence[float] = WHITE) -> np.ndarray:
        """(H, W, 3) uint8: the color of `rasterize` clipped and rounded, at less cost."""
        return self.rasterizer.render_uint8(gaussians, camera, background)
