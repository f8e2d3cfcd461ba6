"""The player's compiled rasterizer: exact, C++, NumPy arrays in and out."""

from __future__ import annotations

import ctypes
import dataclasses
from time import perf_counter

import numpy as np

from .. import native_library as nl
from ..camera import Camera
from ..errors import UserError
from ..gaussians import Gaussians, Rendering
from ..native_library import available
from . import PLAYER_RASTERIZERS
from .rules import TRANSMITTANCE_STOP

__all__ = ["FAST_BLOCK_STOP", "NativeConfig", "NativeRasterizer", "available"]

FAST_BLOCK_STOP = 4e-3  # transmittance: what is left to come moves a color by at most half a step of eight bits


@dataclasses.dataclass
class NativeConfig:
    """threads: of the kernel's pool, 0 for as many as the process has cores (the pool is shared by the process).
    depth: compute the depth image; without it `Rendering.depth` is None.

    What follows trades exactness for speed or looks; docs/splatting.md has what each costs and gains.
    fast: a cubic exponential, and 4x4 blocks that end once no pixel lets 4e-3 through instead of 1e-4.
    backface: above 0, leave out Gaussians whose normal turns away from the camera by a cosine below -backface, if the
    Gaussians have normals. depth_cut: above 0, leave out what lies more than so many metres behind the nearest Gaussian
    of its 32x32 tile. resolution: below 1, draw at so large a part of width and height, then upsample linearly.
    antialiased: opacities times sqrt(det S / det(S + low-pass)), S the 2D covariance (Mip-Splatting, Yu et al. 2024,
    section 4.2, as in gsplat): small Gaussians do not grow brighter with distance. An avatar trained with it wants it.
    """

    threads: int = 0
    depth: bool = True
    fast: bool = False
    backface: float = 0.0
    depth_cut: float = 0.0
    resolution: float = 1.0
    antialiased: bool = False

    def __post_init__(self):
        check_switches(self)


def check_switches(config) -> None:
    """UserError where a switch is out of its range."""
    if not 0 <= config.backface < 1:
        raise UserError(f"rasterizer.backface must be a cosine in [0, 1), 0 for off, got {config.backface}")
    if not 0 <= config.depth_cut < 1e30:
        raise UserError(f"rasterizer.depth_cut must be metres, 0 for off, got {config.depth_cut}")
    if not 0 < config.resolution <= 1:
        raise UserError(f"rasterizer.resolution must be in (0, 1], 1 for off, got {config.resolution}")


@PLAYER_RASTERIZERS.register("native", config=NativeConfig, summary="exact, compiled, many times faster than numpy")
class NativeRasterizer:
    """Exact splatting of NumPy arrays on the CPU, following `rasterizers.rules`.

    The images of a Rendering are buffers that the next call with the same image size fills again: copy what is to be
    kept. Arrays that are not float32 and contiguous are converted on every call. Raises UserError where the kernel was
    not compiled. stage_seconds: wall seconds of `project`, `sort` and `blend` of the last call.
    """

    differentiable = False

    def __init__(self, config: NativeConfig | None = None):
        self.config = config or NativeConfig()
        self._lib = nl.library()
        nl.set_threads(self.config.threads)
        self._frame = nl.Frame()
        self._report = nl.ReportStruct()
        self._buffers: dict[str, np.ndarray] = {}
        self.stage_seconds: dict[str, float] = {}

    @property
    def wants_normals(self) -> bool:
        """Whether `Gaussians.normals` would be of use."""
        return self.config.backface > 0

    def render(self, gaussians: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0)) -> Rendering:
        """The frame as float32: color (H, W, 3), alpha (H, W), depth (H, W) metres. background: (3,) in [0, 1]."""
        small = reduced(camera, self.config.resolution)
        size = (small.height, small.width)
        color, alpha = self._buffer("color", (*size, 3)), self._buffer("alpha", size)
        depth = self._buffer("depth", size) if self.config.depth else None
        self._forward(gaussians, small, background, color=color, alpha=alpha, depth=depth)
        if small is not camera:
            color, alpha, depth = (
                image if image is None else self._enlarged(name, image, camera)
                for name, image in (("color", color), ("alpha", alpha), ("depth", depth))
            )
        return Rendering(color, alpha, depth, dropped=self._report.dropped)

    def render_uint8(self, gaussians: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0)) -> np.ndarray:
        """(H, W, 3) uint8, the color of `render` clipped to [0, 1] and rounded; alpha and depth are not computed."""
        small = reduced(camera, self.config.resolution)
        color8 = self._buffer("color8", (small.height, small.width, 3), np.uint8)
        self._forward(gaussians, small, background, color8=color8)
        return color8 if small is camera else self._enlarged("color8", color8, camera)

    def _enlarged(self, name: str, image: np.ndarray, camera: Camera) -> np.ndarray:
        large = self._buffer(f"large {name}", (camera.height, camera.width, *image.shape[2:]), image.dtype)
        started = perf_counter()
        resize(image, large)
        self.stage_seconds["upsample"] = self.stage_seconds.get("upsample", 0.0) + perf_counter() - started
        return large

    def _buffer(self, name: str, shape: tuple[int, ...], dtype=np.float32) -> np.ndarray:
        buffer = self._buffers.get(name)
        if buffer is None or buffer.shape != shape:
            buffer = self._buffers[name] = np.empty(shape, dtype)
        return buffer

    def _forward(self, gaussians: Gaussians, camera: Camera, background, **images) -> None:
        arrays, struct = gaussians_struct(gaussians)
        camera_struct = nl.camera_struct(camera)
        r, g, b = (float(x) for x in background)
        options = nl.OptionsStruct(
            (ctypes.c_float * 3)(r, g, b), TRANSMITTANCE_STOP, FAST_BLOCK_STOP, 0, int(self.config.fast),
            int(self.config.antialiased), self.config.backface, self.config.depth_cut,
        )  # fmt: skip
        outputs = nl.ImagesStruct(**{k: None if v is None else v.ctypes.data for k, v in images.items()})
        report = self._report
        pointers = (ctypes.byref(x) for x in (struct, camera_struct, options, outputs, report))
        nl.check(self._lib.gv_forward(self._frame.handle, *pointers))
        del arrays  # alive until here
        self.stage_seconds = {"project": report.project_s, "sort": report.sort_s, "blend": report.blend_s}


def reduced(camera: Camera, resolution: float) -> Camera:
    """The camera of an image `resolution` times as wide and high, in whole pixels, at least one; itself at 1."""
    if resolution == 1:
        return camera
    width, height = (max(1, round(resolution * pixels)) for pixels in (camera.width, camera.height))
    x, y = width / camera.width, height / camera.height
    return dataclasses.replace(
        camera, width=width, height=height, fx=camera.fx * x, fy=camera.fy * y, cx=camera.cx * x, cy=camera.cy * y
    )


def resize(image: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` with `image` at its size, linearly, as cv2.resize does it: both (H, W) or (H, W, 3), of float32 or
    uint8, contiguous."""
    scale = nl.library().gv_resize8 if image.dtype == np.uint8 else nl.library().gv_resize
    channels = image[0, 0].size
    nl.check(scale(*image.shape[:2], channels, image.ctypes.data, *out.shape[:2], out.ctypes.data))


def gaussians_struct(gaussians: Gaussians) -> tuple[list[np.ndarray | None], nl.GaussiansStruct]:
    """The arrays as the kernel wants them, which the caller keeps alive, and the struct that points to them.

    Raises ValueError for arrays whose shapes do not belong together.
    """
    n = len(gaussians.means)
    shapes = {
        "means": [(n, 3)],
        "scales": [(n,), (n, 3)],
        "colors": [(n, 3)],
        "opacities": [(n,)],
        "quaternions": [(n, 4)],
        "normals": [(n, 3)],
    }
    arrays = []
    for name, allowed in shapes.items():
        value = getattr(gaussians, name)
        if value is not None:
            value = np.ascontiguousarray(value, np.float32)
            if value.shape not in allowed:
                raise ValueError(f"gaussians.{name}: expected shape {allowed[0]}, got {value.shape}")
        elif name in ("means", "scales", "colors"):
            raise ValueError(f"gaussians.{name} is missing")
        arrays.append(value)
    pointers = [None if a is None else a.ctypes.data for a in arrays]
    return arrays, nl.GaussiansStruct(n, *pointers, 3 if arrays[1].ndim == 2 else 1)
