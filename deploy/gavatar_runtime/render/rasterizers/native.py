"""The player's compiled rasterizer: exact, C++, NumPy arrays in and out."""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Sequence
from time import perf_counter

import numpy as np

from ... import native_library as nl
from ...native_library import available
from ...values.camera import Camera
from ...values.gaussians import Gaussians, Rendering
from . import PLAYER_RASTERIZERS, WHITE, Rasterizer, RasterizerTraits
from .native_options import NativeOptions

__all__ = ["NativeConfig", "NativeRasterizer", "available"]


@dataclasses.dataclass
class NativeConfig(NativeOptions):
    """As in training, and depth: compute the depth image; without it `Rendering.depth` is None."""

    depth: bool = True


@PLAYER_RASTERIZERS.register(
    "native",
    config=NativeConfig,
    summary="exact, compiled, many times faster than numpy",
    missing=lambda: available()[1],
    traits=RasterizerTraits(
        preference=2, measured=({"fast": True}, {"backface": 0.3}, {"depth_cut": 0.3}, {"resolution": 0.5})
    ),
)
class NativeRasterizer(Rasterizer):
    """Exact splatting of NumPy arrays on the CPU, following `splatting_rule`.

    The images of a Rendering are buffers that the next call with the same image size fills again: copy what is to be
    kept. Arrays that are not float32 and contiguous are converted on every call. Raises UserError where the kernel was
    not compiled. stage_seconds: wall seconds of `project`, `sort` and `blend` of the last call.
    """

    def __init__(self, config: NativeConfig | None = None):
        self.config = config or NativeConfig()
        self._lib = nl.library()
        nl.set_threads(self.config.threads)
        self._frame = nl.Frame()
        self._report = nl.ReportStruct()
        self._buffers: dict[str, np.ndarray] = {}
        self.stage_seconds: dict[str, float] = {}

    @property
    def entries(self) -> int:
        """Pairs of a Gaussian and a tile that it reaches, in the last call."""
        return int(self._report.entries)

    @property
    def wants_normals(self) -> bool:
        """Whether `Gaussians.normals` would be of use."""
        return self.config.backface > 0

    def render(self, gaussians: Gaussians, camera: Camera, background: Sequence[float] = WHITE) -> Rendering:
        """The frame as float32: color (H, W, 3), alpha (H, W), depth (H, W) metres. background: (3,) in [0, 1]."""
        small = self.config.drawn_by(camera)
        size = (small.height, small.width)
        color, alpha = self._buffer("color", (*size, 3)), self._buffer("alpha", size)
        depth = self._buffer("depth", size) if self.config.depth else None
        self._forward(gaussians, small, background, color=color, alpha=alpha, depth=depth)
        if small is not camera:
            color, alpha = self._enlarged("color", color, camera), self._enlarged("alpha", alpha, camera)
            depth = None if depth is None else self._enlarged("depth", depth, camera)
        return Rendering(color, alpha, depth, dropped=self._report.dropped)

    def render_uint8(self, gaussians: Gaussians, camera: Camera, background: Sequence[float] = WHITE) -> np.ndarray:
        """(H, W, 3) uint8, the color of `render` clipped to [0, 1] and rounded; alpha and depth are not computed."""
        small = self.config.drawn_by(camera)
        color8 = self._buffer("color8", (small.height, small.width, 3), np.uint8)
        self._forward(gaussians, small, background, color8=color8)
        return color8 if small is camera else self._enlarged("color8", color8, camera)

    def _enlarged(self, name: str, image: np.ndarray, camera: Camera) -> np.ndarray:
        large = self._buffer(f"large {name}", (camera.height, camera.width, *image.shape[2:]), image.dtype.type)
        started = perf_counter()
        resize(image, large)
        self.stage_seconds["upsample"] = self.stage_seconds.get("upsample", 0.0) + perf_counter() - started
        return large

    def _buffer(self, name: str, shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
        buffer = self._buffers.get(name)
        if buffer is None or buffer.shape != shape:
            buffer = self._buffers[name] = np.empty(shape, dtype)
        return buffer

    def _forward(
        self, gaussians: Gaussians, camera: Camera, background: Sequence[float], **images: np.ndarray | None
    ) -> None:
        arrays, struct = gaussians_struct(gaussians)
        camera_struct = nl.camera_struct(camera)
        options = self.config.struct(background)
        outputs = nl.ImagesStruct(**{k: None if v is None else v.ctypes.data for k, v in images.items()})
        report = self._report
        pointers = (ctypes.byref(x) for x in (struct, camera_struct, options, outputs, report))
        nl.check(self._lib.gv_forward(self._frame.handle, *pointers))
        del arrays  # alive until here
        self.stage_seconds = {"project": report.project_s, "sort": report.sort_s, "blend": report.blend_s}


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
    shapes: dict[str, list[tuple[int, ...]]] = {
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
