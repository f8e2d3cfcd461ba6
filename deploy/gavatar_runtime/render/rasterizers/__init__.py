"""The player's rasterizers, by name, and what each of them does."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from ...components import Registry
from ...values.camera import Camera
from ...values.gaussians import Gaussians, Rendering
from ..pixels import to_bytes

# Switches that an avatar is trained with and therefore played with, kept in its bundle's manifest. Not `resolution`:
# that is a part of a size which the player chooses itself.
SWITCHES = ("antialiased", "fast", "backface", "depth_cut")
WHITE = (1.0, 1.0, 1.0)


class Rasterizer(Protocol):
    """What draws Gaussians, following `rules`. A registered class is constructed as `factory(options)` and derives from
    this one, which leaves only `render` and `stage_seconds` to be written.

    stage_seconds: wall seconds of the stages of the last call, by name: `project`, `sort` and `blend` if it has them.
    """

    stage_seconds: dict[str, float]

    @property
    def wants_normals(self) -> bool:
        """Whether `Gaussians.normals` would be of use: an avatar computes them only then."""
        return False

    def render(self, gaussians: Gaussians, camera: Camera, background: Sequence[float] = WHITE) -> Rendering:
        """The frame as float32: color (H, W, 3), alpha (H, W), depth (H, W) metres or None, in arrays that the next
        call may fill again. background: (3,) sRGB in [0, 1]."""
        raise NotImplementedError

    def render_uint8(self, gaussians: Gaussians, camera: Camera, background: Sequence[float] = WHITE) -> np.ndarray:
        """(H, W, 3) uint8, the color of `render` clipped to [0, 1] and rounded, in an array that the next call may fill
        again."""
        return to_bytes(self.render(gaussians, camera, background).color)


@dataclasses.dataclass(frozen=True)
class RasterizerTraits:
    """preference: above 0, the player may choose it by itself, the highest of those that can be had. measured: options
    that trade accuracy for speed, each to be tried by itself where it is measured what playing costs."""

    preference: int = 0
    measured: tuple[Mapping[str, Any], ...] = ()


PLAYER_RASTERIZERS: Registry[Rasterizer] = Registry("rasterizer", RasterizerTraits)
