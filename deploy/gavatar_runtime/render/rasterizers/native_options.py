"""What the native kernel can be asked for, in playing and in training alike."""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Iterable

from ... import native_library as nl
from ...errors import WrongValue
from ...splatting_rule import TRANSMITTANCE_STOP
from ...values.camera import Camera

FAST_BLOCK_STOP = 4e-3  # transmittance: what is left to come moves a color by at most half a step of eight bits


@dataclasses.dataclass
class NativeOptions:
    """threads: of the kernel's pool, 0 for as many as `cpus.usable_cpus` (the pool is shared by the process).

    What follows trades exactness for speed or looks; docs/lab/splatting.md has what each costs and gains.
    fast: a cubic exponential, and 4x4 blocks that end once no pixel lets 4e-3 through instead of 1e-4.
    backface: above 0, leave out Gaussians whose normal turns away from the camera by a cosine below -backface, if the
    Gaussians have normals. depth_cut: above 0, leave out what lies more than so many metres behind the nearest Gaussian
    of its 32x32 tile. resolution: below 1, draw at so large a part of width and height, then upsample linearly.
    antialiased: opacities times sqrt(det S / det(S + low-pass)), S the 2D covariance (Mip-Splatting, Yu et al. 2024,
    section 4.2, as in gsplat): small Gaussians do not grow brighter with distance. An avatar trained with it wants it.
    Raises WrongValue where one is out of its range.
    """

    threads: int = 0
    fast: bool = False
    backface: float = 0.0
    depth_cut: float = 0.0
    resolution: float = 1.0
    antialiased: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.backface < 1:
            raise WrongValue(f"rasterizer.backface must be a cosine in [0, 1), 0 for off, got {self.backface}")
        if not 0 <= self.depth_cut < 1e30:
            raise WrongValue(f"rasterizer.depth_cut must be metres, 0 for off, got {self.depth_cut}")
        if not 0 < self.resolution <= 1:
            raise WrongValue(f"rasterizer.resolution must be in (0, 1], 1 for off, got {self.resolution}")

    def struct(self, background: Iterable[float], *, keep: bool = False) -> nl.OptionsStruct:
        """The options of one forward. background: (3,) in [0, 1]. keep: leave in the frame what a backward needs."""
        r, g, b = (float(x) for x in background)
        return nl.OptionsStruct(
            background=(ctypes.c_float * 3)(r, g, b),
            transmittance_stop=TRANSMITTANCE_STOP,
            block_stop=FAST_BLOCK_STOP,
            keep=int(keep),
            fast=int(self.fast),
            antialiased=int(self.antialiased),
            backface=self.backface,
            depth_cut=self.depth_cut,
        )

    def drawn_by(self, camera: Camera) -> Camera:
        """The camera of an image `resolution` times as wide and high, in whole pixels, at least one; itself at 1."""
        if self.resolution == 1:
            return camera
        width, height = (max(1, round(self.resolution * pixels)) for pixels in (camera.width, camera.height))
        x, y = width / camera.width, height / camera.height
        return dataclasses.replace(
            camera, width=width, height=height, fx=camera.fx * x, fy=camera.fy * y, cx=camera.cx * x, cy=camera.cy * y
        )
