"""The player's rasterizer without compiled code: exact to `rules`, NumPy alone, float32 or float64.

A frame is `project`, `sort` and blend (`numpy_tiles`), which can be called and timed one by one.
"""

from __future__ import annotations

import dataclasses
import math
from time import perf_counter

import numpy as np

from ..camera import Camera
from ..errors import UserError
from ..gaussians import Gaussians, Rendering
from ..rotations import matrix_from_quaternion
from . import PLAYER_RASTERIZERS
from .numpy_tiles import Canvas, Splats, TileLists, stable_order
from .rules import ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, NEAR

STAGES = ("project", "sort", "blend")


@dataclasses.dataclass
class NumpyRasterizerConfig:
    """dtype: `float32` or `float64`, what the frame is computed in."""

    dtype: str = "float32"

    def __post_init__(self):
        if self.dtype not in ("float32", "float64"):
            raise UserError(f"rasterizer.dtype must be float32 or float64, got '{self.dtype}'")


@PLAYER_RASTERIZERS.register("numpy", config=NumpyRasterizerConfig, summary="exact, plain NumPy, nothing compiled")
class NumpyRasterizer:
    """Exact splatting of NumPy arrays.

    Contract of every rasterizer of the player: `render(gaussians, camera, background) -> Rendering` follows `rules`
    and takes arrays of any float type and a background of three numbers in [0, 1]; the next call may fill the same
    Rendering again. `stage_seconds` holds the wall seconds of `project`, `sort` and `blend` of the last call.
    `differentiable` is False. Raises UserError for what it cannot do.
    """

    differentiable = False

    def __init__(self, config: NumpyRasterizerConfig | None = None):
        self.config = config or NumpyRasterizerConfig()
        self.stage_seconds: dict[str, float] = {}

    def render(self, gaussians: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0)) -> Rendering:
        """The frame in the configured dtype: color (H, W, 3), alpha (H, W), depth (H, W) metres."""
        self.stage_seconds = dict.fromkeys(STAGES, 0.0)
        return render(gaussians, camera, background, np.dtype(self.config.dtype), self.stage_seconds)


def render(
    gaussians: Gaussians,
    camera: Camera,
    background=(1.0, 1.0, 1.0),
    dtype=np.float32,
    stage_seconds: dict[str, float] | None = None,
) -> Rendering:
    """The frame in `dtype`. stage_seconds: the seconds of each of `STAGES` are added to it."""
    clock = [perf_counter()]

    def lap(stage: str) -> None:
        clock.append(perf_counter())
        if stage_seconds is not None:
            stage_seconds[stage] = stage_seconds.get(stage, 0.0) + clock[-1] - clock[-2]

    splats = project(gaussians, camera, dtype)
    lap("project")
    splats = sort(splats)
    lists, canvas = TileLists(splats, camera), Canvas(splats, camera)
    for run in lists.slabs():
        alive = canvas.alive()
        if not alive.any():
            break
        slab = lists.lists(run, alive)
        lap("sort")
        canvas.blend(*slab)
        lap("blend")
    rendering = canvas.rendering(background, splats.dropped)
    lap("blend")
    return rendering


def project(gaussians: Gaussians, camera: Camera, dtype=np.float32) -> Splats:
    """Stage 1: the Gaussians that may touch a pixel, in their own order, computed in `dtype`."""
    fields = {name: value for name, value in vars(gaussians).items() if value is not None}
    gaussians = Gaussians(**{name: np.asarray(value, dtype) for name, value in fields.items()})
    good = _finite(gaussians)
    fx, fy, cx, cy = (float(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    with np.errstate(all="ignore"):  # what lies on the camera's plane or is not finite is left out below
        x, y, z = _camera_points(gaussians.means, camera)
        ratio_x, ratio_y = x / z, y / z
        x, y = ratio_x * fx + cx, ratio_y * fy + cy
        margin_x, margin_y = FRUSTUM_MARGIN * camera.width / 2, FRUSTUM_MARGIN * camera.height / 2
        ratio_x = np.clip(ratio_x, (-margin_x - cx) / fx, (camera.width + margin_x - cx) / fx)
        ratio_y = np.clip(ratio_y, (-margin_y - cy) / fy, (camera.height + margin_y - cy) / fy)
        covariance = _covariance_isotropic if gaussians.scales.ndim == 1 else _covariance
        xx, xy, yy, det = covariance(gaussians, z, ratio_x, ratio_y, camera)
        # the determinant of (Sigma + LOW_PASS I), free of the cancellation in xx yy - xy^2
        det = det + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS
        xx, yy = xx + LOW_PASS, yy + LOW_PASS
        log_opacity = np.zeros_like(z) if gaussians.opacities is None else np.log(gaussians.opacities)
        columns, some_column = _pixel_range(x, xx, log_opacity, camera.width)
        rows, some_row = _pixel_range(y, yy, log_opacity, camera.height)
        seen = np.flatnonzero(good & (z > NEAR) & some_column & some_row)
        conic = tuple(entry[seen] for entry in (yy / det, -xy / det, xx / det))
    bounds = (np.stack([a[seen], b[seen]], 1).astype(np.int64) for a, b in zip(columns, rows, strict=True))
    dropped = len(good) - int(np.count_nonzero(good))
    return Splats(x[seen], y[seen], conic, log_opacity[seen], z[seen], gaussians.colors[seen], *bounds, dropped)


def sort(splats: Splats) -> Splats:
    """Stage 2: the splats in (float32 depth, index) order. `TileLists` then deals them out to the tiles."""
    # depths are positive, and positive floats order like their bits
    return splats.take(stable_order(splats.depth.astype(np.float32).view(np.uint32)))


def _finite(gaussians: Gaussians) -> np.ndarray:
    """(N,) bool: every field is finite and no scale is negative."""
    good = np.ones(len(gaussians.means), bool)
    for name, value in vars(gaussians).items():
        if value is not None:
            fine = np.isfinite(value)
            if name == "scales":
                fine &= value >= 0
            for column in fine.reshape(len(fine), -1).T if len(fine) else ():
                good &= column
    return good


def _camera_points(means: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates in the camera frame, (N,) each. Spelt out, since a matrix product may round equal rows unequally,
    and equal points must get equal depths."""
    x, y, z = np.ascontiguousarray(means.T)
    rows = np.asarray(camera.T_camera_world)[:3].tolist()
    return tuple(x * row[0] + y * row[1] + z * row[2] + row[3] for row in rows)


def _covariance_isotropic(gaussians: Gaussians, z, ratio_x, ratio_y, camera: Camera):
    """(xx, xy, yy, det) of s^2 J J^T, px^2."""
    fx, fy = float(camera.fx), float(camera.fy)
    k = np.square(gaussians.scales / z)
    kx, ky = k * fx**2, k * fy**2
    xx, yy = 1 + np.square(ratio_x), 1 + np.square(ratio_y)
    return kx * xx, k * (fx * fy) * ratio_x * ratio_y, ky * yy, kx * ky * (xx + np.square(ratio_y))


def _covariance(gaussians: Gaussians, z, ratio_x, ratio_y, camera: Camera):
    """(xx, xy, yy, det) of M M^T with M = J R diag(scales), px^2; det = |m_x x m_y|^2 by Lagrange's identity."""
    axes = np.asarray(camera.T_camera_world)[:3, :3].astype(z.dtype)
    if gaussians.quaternions is not None:
        axes = axes @ matrix_from_quaternion(gaussians.quaternions)
    axes = axes * gaussians.scales[:, None, :]
    m_x = (float(camera.fx) / z)[:, None] * (axes[:, 0] - ratio_x[:, None] * axes[:, 2])
    m_y = (float(camera.fy) / z)[:, None] * (axes[:, 1] - ratio_y[:, None] * axes[:, 2])
    det = np.square(np.cross(m_x, m_y)).sum(1)
    return np.square(m_x).sum(1), (m_x * m_y).sum(1), np.square(m_y).sum(1), det


def _pixel_range(centre, variance, log_opacity, size: int):
    """((first, last), any): along one axis of `size` pixels, those whose centres may lie in the support, still as
    floats, and whether there are any."""
    reach = 2 * (log_opacity - math.log(ALPHA_MIN))
    # the range may be generous, never short: a support's edge carries the rounding of its extent
    extent = np.sqrt(reach * variance) * 1.0001 + 0.01  # NaN, hence nowhere, where opacity is below ALPHA_MIN
    first = np.maximum(np.ceil(centre - extent - 0.5), 0)
    last = np.minimum(np.floor(centre + extent - 0.5), size - 1)
    return (first, last), last >= first
