"""The splatting rule in NumPy: the player's plain reference, and what draws where nothing is compiled."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from time import perf_counter

import numpy as np

from ...geometry.rotations import matrix_from_quaternion
from ...splatting_rule import ALPHA_MAX, ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, NEAR, TRANSMITTANCE_STOP
from ...values.camera import Camera
from ...values.gaussians import Gaussians, Rendering
from . import PLAYER_RASTERIZERS, WHITE, Rasterizer, RasterizerTraits

TILE = 8  # pixels; small tiles waste few pairs of pixel and Gaussian
CHUNK = 64  # Gaussians blended at once, so that a saturated tile stops early


@dataclasses.dataclass(frozen=True, eq=False)
class Splats:
    """Gaussians on the image, in (float32 depth, index) order. center: (M, 2) px. conic: (M, 3) inverse covariance
    xx, xy, yy. extent: (M, 2) px half-sides of the box of {alpha >= ALPHA_MIN}. depth, opacity: (M,). color: (M, 3).
    dropped: Gaussians with a field that is not finite or a negative scale."""

    center: np.ndarray
    conic: np.ndarray
    extent: np.ndarray
    depth: np.ndarray
    opacity: np.ndarray
    color: np.ndarray
    dropped: int


def project(
    gaussians: Gaussians, camera: Camera, dtype: type[np.floating] = np.float32, antialiased: bool = False
) -> Splats:
    """Project and sort, steps 1 and 2 of the rule; `antialiased` as in `NativeConfig`."""
    N = len(gaussians.means)
    means, scales, colors = (np.asarray(a, dtype) for a in (gaussians.means, gaussians.scales, gaussians.colors))
    opacity = np.ones(N, dtype) if gaussians.opacities is None else np.asarray(gaussians.opacities, dtype)
    good = np.isfinite(means).all(1) & np.isfinite(colors).all(1) & np.isfinite(opacity)
    good &= (np.isfinite(scales) & (scales >= 0)).all(tuple(range(1, scales.ndim)))
    if gaussians.quaternions is not None:
        good &= np.isfinite(np.asarray(gaussians.quaternions)).all(1)
    R, t = camera.T_camera_world[:3, :3].astype(dtype), camera.T_camera_world[:3, 3].astype(dtype)
    with np.errstate(all="ignore"):
        x, y, z = (means @ R.T + t).T
        keep = np.flatnonzero(good & (z > NEAR) & (opacity >= ALPHA_MIN))
    x, y, z, opacity, scales = x[keep], y[keep], z[keep], opacity[keep], scales[keep]
    cov = _covariance(gaussians, camera, keep, x / z, y / z, z, scales, R)
    if antialiased:
        opacity = opacity * _compensation(cov)
        keep, z, cov, opacity, x, y = (a[opacity >= ALPHA_MIN] for a in (keep, z, cov, opacity, x, y))
    with np.errstate(all="ignore"):
        det = cov[:, 0] * cov[:, 2] - cov[:, 1] ** 2
        conic = np.stack([cov[:, 2] / det, -cov[:, 1] / det, cov[:, 0] / det], -1)
        reach = 2 * np.log(opacity / dtype(ALPHA_MIN))
        extent = np.sqrt(np.maximum(reach, 0)[:, None] * cov[:, [0, 2]])
        center = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], -1).astype(dtype)
        seen = (center + extent > 0).all(1) & (center - extent < [camera.width, camera.height]).all(1) & (det > 0)
    order = np.flatnonzero(seen)
    order = order[np.argsort(z[order].astype(np.float32), kind="stable")]
    color = colors[keep][order]
    return Splats(center[order], conic[order], extent[order], z[order], opacity[order], color, int(N - good.sum()))


def _compensation(cov: np.ndarray) -> np.ndarray:
    """(M,) sqrt(det S / det(S + low-pass)) of (M, 3) covariances with the low-pass, 1 where they are not finite."""
    xx, xy, yy = cov.astype(np.float64).T
    with np.errstate(all="ignore"):
        sharp, blurred = (xx - LOW_PASS) * (yy - LOW_PASS) - xy**2, xx * yy - xy**2
        ratio = np.maximum(sharp, 0) / blurred
    return np.sqrt(np.where(ratio < 1, ratio, 1)).astype(cov.dtype)


def _covariance(
    gaussians: Gaussians, camera: Camera, keep: np.ndarray, u: np.ndarray, v: np.ndarray, z: np.ndarray,
    scales: np.ndarray, R: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(M, 3) image covariance xx, xy, yy in px^2, low-pass included."""
    dtype = z.dtype
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * camera.width, FRUSTUM_MARGIN * 0.5 * camera.height
    u = np.clip(u, -(camera.cx + margin_x) / camera.fx, (camera.width - camera.cx + margin_x) / camera.fx)
    v = np.clip(v, -(camera.cy + margin_y) / camera.fy, (camera.height - camera.cy + margin_y) / camera.fy)
    zero = np.zeros_like(z)
    row_x = np.stack([camera.fx / z, zero, -camera.fx * u / z], -1)
    row_y = np.stack([zero, camera.fy / z, -camera.fy * v / z], -1)
    J = np.stack([row_x, row_y], -2).astype(dtype)
    if scales.ndim == 1:
        L = J * scales[:, None, None]
    else:
        M = R
        if gaussians.quaternions is not None:
            M = R @ matrix_from_quaternion(np.asarray(gaussians.quaternions, dtype)[keep])
        L = (J @ M) * scales[:, None, :]
    cov = L @ np.swapaxes(L, -1, -2)
    low = dtype.type(LOW_PASS)
    return np.stack([cov[:, 0, 0] + low, cov[:, 0, 1], cov[:, 1, 1] + low], -1)


def tile_lists(splats: Splats, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Which splats touch which tile: (P,) tile number, row-major, and (P,) splat, front to back within a tile."""
    across, down = -(-camera.width // TILE), -(-camera.height // TILE)
    low = np.floor((splats.center - splats.extent) / TILE)
    high = np.floor((splats.center + splats.extent) / TILE)
    first = np.clip(low, 0, [across - 1, down - 1]).astype(np.int64)
    span = np.clip(high, 0, [across - 1, down - 1]).astype(np.int64) - first + 1
    count = span.prod(1)
    splat = np.repeat(np.arange(len(count)), count)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    width = span[splat, 0]
    tile = (first[splat, 1] + within // width) * across + first[splat, 0] + within % width
    order = np.argsort(tile, kind="stable")
    return tile[order], splat[order]


def blend(
    splats: Splats, tile: np.ndarray, splat: np.ndarray, camera: Camera, background: Sequence[float] | np.ndarray
) -> Rendering:
    """Steps 3 and 4 of the rule, tile by tile."""
    dtype = splats.depth.dtype
    across = -(-camera.width // TILE)
    color = np.zeros((camera.height, camera.width, 3), dtype)
    depth, left = np.zeros((camera.height, camera.width), dtype), np.ones((camera.height, camera.width), dtype)
    tiles, starts = np.unique(tile, return_index=True)
    for number, members in zip(tiles, np.split(splat, starts[1:]) if len(tiles) else (), strict=True):
        top, side = divmod(int(number), across)
        rows = slice(top * TILE, min((top + 1) * TILE, camera.height))
        cols = slice(side * TILE, min((side + 1) * TILE, camera.width))
        px = np.arange(cols.start, cols.stop, dtype=dtype) + dtype.type(0.5)
        py = np.arange(rows.start, rows.stop, dtype=dtype) + dtype.type(0.5)
        rgb, z, T = _blend_tile(splats, members, px, py)
        color[rows, cols], depth[rows, cols], left[rows, cols] = rgb, z, T
    return Rendering(color + left[..., None] * np.asarray(background, dtype), 1 - left, depth, splats.dropped)


def _blend_tile(
    splats: Splats, members: np.ndarray, px: np.ndarray, py: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    dtype = px.dtype
    T = np.ones((len(py), len(px)), dtype)
    alive = np.ones_like(T, bool)
    rgb, z = np.zeros((*T.shape, 3), dtype), np.zeros_like(T)
    for start in range(0, len(members), CHUNK):
        m = members[start : start + CHUNK]
        dx = px - splats.center[m, 0, None]
        dy = py - splats.center[m, 1, None]
        a, b, c = (splats.conic[m, k, None, None] for k in range(3))
        power = -0.5 * (a * dx[:, None] ** 2 + c * dy[:, :, None] ** 2) - b * dx[:, None] * dy[:, :, None]
        alpha = np.minimum(splats.opacity[m, None, None] * np.exp(np.minimum(power, 0)), dtype.type(ALPHA_MAX))
        alpha[alpha < ALPHA_MIN] = 0
        after = T * np.cumprod(1 - alpha, 0)
        before = np.concatenate([T[None], after[:-1]])
        # transmittance only falls, so "has stopped" is just "would be below the stop"
        counts = alive & (after >= TRANSMITTANCE_STOP)
        weight = np.where(counts, alpha * before, 0)
        rgb += np.einsum("mhw,mc->hwc", weight, splats.color[m])
        z += np.einsum("mhw,m->hw", weight, splats.depth[m])
        T = np.where(counts, after, np.inf).min(0, initial=np.inf, where=counts).clip(max=T)
        alive &= counts[-1]
        if not alive.any():
            break
    return rgb, z, T


def render(
    gaussians: Gaussians,
    camera: Camera,
    background: Sequence[float] | np.ndarray = (1.0, 1.0, 1.0),
    dtype: type[np.floating] = np.float32,
) -> Rendering:
    """Draw `gaussians` as `rules` says, in float32 or float64. Arrays of the Rendering have that dtype."""
    splats = project(gaussians, camera, dtype)
    return blend(splats, *tile_lists(splats, camera), camera, background)


@dataclasses.dataclass
class NumpyConfig:
    """antialiased: opacities times sqrt(det S / det(S + low-pass)), as `native` has it."""

    antialiased: bool = False


@PLAYER_RASTERIZERS.register(
    "numpy",
    config=NumpyConfig,
    summary="exact, plain NumPy: the reference, needs nothing compiled",
    traits=RasterizerTraits(preference=1),
)
class NumpyRasterizer(Rasterizer):
    """Tile by tile, plainly."""

    def __init__(self, config: NumpyConfig | None = None):
        self.config = config or NumpyConfig()
        self.stage_seconds: dict[str, float] = {}

    def render(self, gaussians: Gaussians, camera: Camera, background: Sequence[float] = WHITE) -> Rendering:
        """Float32 rendering; see `rules`."""
        times = [perf_counter()]
        splats = project(gaussians, camera, antialiased=self.config.antialiased)
        times.append(perf_counter())
        lists = tile_lists(splats, camera)
        times.append(perf_counter())
        rendering = blend(splats, *lists, camera, background)
        times.append(perf_counter())
        self.stage_seconds = dict(zip(("project", "sort", "blend"), np.diff(times).tolist(), strict=True))
        return rendering
