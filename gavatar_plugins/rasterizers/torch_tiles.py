"""The differentiable reference rasterizer in plain torch: exact to `gavatar_runtime.rasterizers.rules`, any device.

A frame goes through four steps:

1. `project` turns Gaussians into screen ellipses (`Splats`); ordinary autograd differentiates it.
2. `TileLists` writes down, front to back, which splats touch which tile.
3. `blend` walks the lists, many tiles at a time and `chunk` list positions at a time, and forgets a tile as soon as all
   of its pixels have stopped. With opaque Gaussians that is after some hundred of them, whatever lies behind.
4. The backward pass replays the same chunks. With weights w_j and s_j = dL/dw_j, the derivative by the opacity of the
   i-th splat of a pixel is `T_i s_i - (sum_{j>i} w_j s_j) / (1 - alpha_i)`, and the sum is what remains of the pixel's
   total, so one pass front to back suffices.

Inside a tile the exponent of a splat is a quadratic polynomial of the pixel's position, hence one matrix product of six
coefficients a splat with six monomials a pixel, forward and backward. Arrays of step 3 and 4 are laid out as
(pixel of the tile, tile, list position).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator

import torch
from gavatar_runtime.camera import Camera
from gavatar_runtime.errors import UserError
from gavatar_runtime.gaussians import Gaussians, Rendering
from gavatar_runtime.rasterizers.rules import ALPHA_MAX, ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, NEAR, TRANSMITTANCE_STOP
from torch import Tensor
from torch.autograd.function import once_differentiable

from gavatar.registry import RASTERIZERS

FIELDS = ("means", "scales", "colors", "opacities", "quaternions")


@dataclasses.dataclass
class TorchRasterizerConfig:
    """tile_size: pixels on a side. chunk: list positions blended at once. slab: (splat, tile) pairs listed at once.
    batch: (pixel, splat) pairs evaluated at once.

    None of them changes the picture; slab and batch bound the memory.
    """

    tile_size: int = 4
    chunk: int = 32
    slab: int = 1 << 18
    batch: int = 1 << 20

    def __post_init__(self):
        for field in dataclasses.fields(self):
            if getattr(self, field.name) < 1:
                raise UserError(f"rasterizer.{field.name} must be at least 1, got {getattr(self, field.name)}")


@RASTERIZERS.register("torch", config=TorchRasterizerConfig, summary="exact, differentiable, plain torch on any device")
class TorchRasterizer:
    """Exact splatting with torch tensors.

    Contract of every rasterizer in the registry: `rasterizer(gaussians, camera, background) -> Rendering`, where the
    Gaussians' fields are torch tensors of one floating dtype and device, background is three numbers or a (3,) tensor,
    and the Rendering follows `rasterizers.rules` with tensors of the same dtype and device. `differentiable` says
    whether gradients reach means, scales, colors, opacities, quaternions and background from color, alpha and depth.
    Raises UserError for what it cannot do.
    """

    differentiable = True

    def __init__(self, config: TorchRasterizerConfig):
        self.config = config

    def __call__(self, gaussians: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0)) -> Rendering:
        detached = Gaussians(*(_detached(getattr(gaussians, name)) for name in FIELDS))
        finite = finite_mask(detached)
        visible = visible_in_order(project(detached, camera), finite, camera)
        splats = project(_selected(gaussians, visible), camera)
        colors = gaussians.colors.index_select(0, visible)
        background = torch.as_tensor(background, dtype=colors.dtype, device=colors.device)
        geometry = torch.cat([splats.xy, splats.conic, splats.log_opacity[:, None]], 1)
        features = torch.cat([colors, splats.depth[:, None], torch.ones_like(colors[:, :1])], 1)
        blended = _Blend.apply(geometry, features, splats.extent.detach(), camera.width, camera.height, self.config)
        alpha = blended[..., 4]
        color = blended[..., :3] + (1 - alpha)[..., None] * background
        return Rendering(color, alpha, blended[..., 3], dropped=len(finite) - int(finite.sum()))


def _detached(value: Tensor | None) -> Tensor | None:
    return None if value is None else value.detach()


def _selected(gaussians: Gaussians, index: Tensor) -> Gaussians:
    values = (getattr(gaussians, name) for name in FIELDS)
    return Gaussians(*(None if value is None else value.index_select(0, index) for value in values))


def finite_mask(gaussians: Gaussians) -> Tensor:
    """(N,) bool: every field is finite and no scale is negative."""
    good = torch.ones(len(gaussians.means), dtype=torch.bool, device=gaussians.means.device)
    for name in FIELDS:
        value = getattr(gaussians, name)
        if value is not None:
            fine = torch.isfinite(value)
            fine = fine & (value >= 0) if name == "scales" else fine
            good &= fine if fine.ndim == 1 else fine.all(1)
    return good


@dataclasses.dataclass
class Splats:
    """N Gaussians on the screen.

    xy: (N, 2) pixels. conic: (N, 3) entries (xx, xy, yy) of the inverse 2D covariance, 1/px^2. log_opacity: (N,).
    depth: (N,) metres. extent: (N, 2) half-width and half-height of the support's bounding box, pixels (negative where
    opacity is below ALPHA_MIN).
    """

    xy: Tensor
    conic: Tensor
    log_opacity: Tensor
    depth: Tensor
    extent: Tensor


def project(gaussians: Gaussians, camera: Camera) -> Splats:
    """The Gaussians as splats; those behind the near plane or not finite come out as rubbish for the caller to skip."""
    x, y, z = _camera_points(gaussians.means, camera)
    ratio_x, ratio_y = x / z, y / z
    xy = torch.stack([camera.fx * ratio_x + camera.cx, camera.fy * ratio_y + camera.cy], 1)
    margin_x, margin_y = FRUSTUM_MARGIN * camera.width / 2, FRUSTUM_MARGIN * camera.height / 2
    ratio_x = ratio_x.clamp((-margin_x - camera.cx) / camera.fx, (camera.width + margin_x - camera.cx) / camera.fx)
    ratio_y = ratio_y.clamp((-margin_y - camera.cy) / camera.fy, (camera.height + margin_y - camera.cy) / camera.fy)
    if gaussians.scales.ndim == 1:
        xx, xy_, yy, det = _covariance_isotropic(gaussians.scales, z, ratio_x, ratio_y, camera)
    else:
        xx, xy_, yy, det = _covariance(gaussians, z, ratio_x, ratio_y, camera)
    # the determinant of (Sigma + LOW_PASS I), free of the cancellation in xx yy - xy^2
    det = det + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS
    xx, yy = xx + LOW_PASS, yy + LOW_PASS
    conic = torch.stack([yy / det, -xy_ / det, xx / det], 1)
    opacities = gaussians.opacities
    log_opacity = torch.zeros_like(z) if opacities is None else opacities.log()
    reach = 2 * (log_opacity.detach() - math.log(ALPHA_MIN))
    extent = (reach[:, None] * torch.stack([xx, yy], 1).detach()).sqrt()
    extent = torch.where(reach[:, None] >= 0, extent, -1)
    return Splats(xy, conic, log_opacity, z, extent)


def _camera_points(means: Tensor, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Coordinates in the camera frame, (N,) each. Spelt out, since a matrix product may round equal rows unequally,
    and equal points must get equal depths."""
    x, y, z = means.unbind(1)
    rows = camera.T_camera_world[:3].tolist()
    return tuple(x * row[0] + y * row[1] + z * row[2] + row[3] for row in rows)


def _covariance_isotropic(scales: Tensor, z: Tensor, ratio_x: Tensor, ratio_y: Tensor, camera: Camera):
    """(xx, xy, yy, det) of s^2 J J^T, px^2."""
    k = (scales / z).square()
    kx, ky = k * camera.fx**2, k * camera.fy**2
    xx, yy = 1 + ratio_x.square(), 1 + ratio_y.square()
    cross = k * (camera.fx * camera.fy) * ratio_x * ratio_y
    return kx * xx, cross, ky * yy, kx * ky * (xx + ratio_y.square())


def _covariance(gaussians: Gaussians, z: Tensor, ratio_x: Tensor, ratio_y: Tensor, camera: Camera):
    """(xx, xy, yy, det) of M M^T with M = J R diag(scales), px^2; det = |m_x x m_y|^2 by Lagrange's identity."""
    world = gaussians.means.new_tensor(camera.T_camera_world[:3, :3].tolist())
    axes = world.expand(len(z), 3, 3)
    if gaussians.quaternions is not None:
        axes = world @ rotation_matrices(gaussians.quaternions)
    axes = axes * gaussians.scales[:, None, :]
    m_x = (camera.fx / z)[:, None] * (axes[:, 0] - ratio_x[:, None] * axes[:, 2])
    m_y = (camera.fy / z)[:, None] * (axes[:, 1] - ratio_y[:, None] * axes[:, 2])
    det = torch.linalg.cross(m_x, m_y).square().sum(1)
    return m_x.square().sum(1), (m_x * m_y).sum(1), m_y.square().sum(1), det


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """(N, 4) wxyz, normalised here -> (N, 3, 3); a zero quaternion gives the identity."""
    norm = quaternions.square().sum(1, keepdim=True)
    zero = norm == 0
    unit = quaternions / torch.where(zero, 1, norm).sqrt()
    w, x, y, z = torch.where(zero, quaternions.new_tensor([1, 0, 0, 0]), unit).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, 1) for row in rows], 1)


def pixel_bounds(xy: Tensor, extent: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """(N, 2) int64 first and last column and row whose centres may lie in the support; last < first where none do."""
    size = xy.new_tensor([width, height])
    # the list may be generous, never short: a support's edge carries the rounding of its extent
    reach = torch.where(extent >= 0, extent * 1.0001 + 0.01, -1)
    first = (xy - reach - 0.5).ceil()
    last = (xy + reach - 0.5).floor()
    return first.clamp(min=0).minimum(size).long(), last.minimum(size - 1).clamp(min=-1).long()


def visible_in_order(splats: Splats, finite: Tensor, camera: Camera) -> Tensor:
    """Indices of the Gaussians that may touch a pixel, in (float32 depth, index) order."""
    first, last = pixel_bounds(splats.xy, splats.extent, camera.width, camera.height)
    seen = finite & (splats.depth > NEAR) & (last >= first).all(1)
    index = seen.nonzero()[:, 0]
    return index[torch.sort(splats.depth[index].float(), stable=True)[1]]


@functools.lru_cache(maxsize=8)
def _monomials(tile_size: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """(P, 6): x^2, xy, y^2, x, y, 1 at the pixel centres, relative to the tile's centre."""
    steps = torch.arange(tile_size, dtype=dtype, device=device) + 0.5 - tile_size / 2
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    x, y = x.reshape(-1), y.reshape(-1)
    return torch.stack([x * x, x * y, y * y, x, y, torch.ones_like(x)], 1)


class TileLists:
    """Which splats touch which tile, produced a slab of splats at a time, front to back.

    Slabs bound the memory when splats cover the whole image, and spare listing what stopped pixels hide.
    """

    def __init__(self, xy: Tensor, extent: Tensor, width: int, height: int, config: TorchRasterizerConfig):
        first, last = pixel_bounds(xy, extent, width, height)
        self.columns = -(-width // config.tile_size)
        self.rows = -(-height // config.tile_size)
        self.first = first // config.tile_size
        self.size = last // config.tile_size - self.first + 1
        self.slab = config.slab

    def slabs(self) -> Iterator[slice]:
        """Runs of consecutive splats with about `slab` (splat, tile) pairs each."""
        pairs = self.size.prod(1).cumsum(0)
        total = int(pairs[-1]) if len(pairs) else 0
        marks = torch.arange(0, total + self.slab, self.slab, device=pairs.device)
        edges = torch.unique_consecutive(torch.searchsorted(pairs, marks)).tolist()
        edges = [0, *(edge for edge in edges if 0 < edge < len(pairs)), len(pairs)]
        for start, stop in zip(edges[:-1], edges[1:], strict=True):
            if stop > start:
                yield slice(start, stop)

    def lists(self, run: slice, alive: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The lists of the splats `run` in the tiles where `alive` (rows * columns,) holds.

        Returns splat (L,) indices, tile after tile and front to back in each, and for the T tiles with any:
        their number (T,), the start of their list (T,) and its length (T,).
        """
        splat, first, size = self._with_live_tiles(run, alive)
        counts = size.prod(1)
        pair = torch.repeat_interleave(counts)
        step = torch.arange(len(pair), device=pair.device) - (counts.cumsum(0) - counts)[pair]
        width = size[:, 0][pair]
        row = step // width
        tile = (first[:, 1][pair] + row) * self.columns + first[:, 0][pair] + step - row * width
        kept = alive[tile]
        pair, tile = pair[kept], tile[kept]
        # the pairs stand in depth order, so a stable sort by tile leaves each tile's list in depth order
        tile, order = torch.sort(tile.int(), stable=True)
        length = torch.bincount(tile, minlength=len(alive))
        tiles = length.nonzero()[:, 0]
        start = (length.cumsum(0) - length)[tiles]
        return splat[pair[order]], tiles, start, length[tiles]

    def _with_live_tiles(self, run: slice, alive: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(index, first tile, size in tiles) of the splats whose rectangle holds a live tile."""
        first, size = self.first[run], self.size[run]
        table = alive.new_zeros((self.rows + 1, self.columns + 1), dtype=torch.long)
        table[1:, 1:] = alive.view(self.rows, self.columns).long().cumsum(0).cumsum(1)
        (x0, y0), (x1, y1) = first.unbind(1), (first + size).unbind(1)
        live = table[y1, x1] - table[y0, x1] - table[y1, x0] + table[y0, x0]
        kept = (live > 0).nonzero()[:, 0]
        return kept + run.start, first[kept], size[kept]


class _Blend(torch.autograd.Function):
    """Front-to-back blending: geometry (M, 6) and features (M, F), in depth order -> (H, W, F) sums of weight x
    feature. Geometry is (x, y, conic xx, xy, yy, log opacity)."""

    @staticmethod
    def forward(ctx, geometry, features, extent, width, height, config):
        lists = TileLists(geometry[:, :2], extent, width, height, config)
        state = _Blender(geometry, features, lists.columns, lists.rows, width, height, config)
        chunks = []
        for run in lists.slabs():
            alive = state.alive()
            if not alive.any():
                break
            splat, tiles, start, length = lists.lists(run, alive)
            for chunk in _chunks(splat, tiles, start, length, len(geometry), state, config):
                chunks.append((*chunk, state.transmittance[:, chunk[0]]))
                state.add(*chunk)
        ctx.chunks, ctx.config, ctx.size = chunks, config, (lists.columns, lists.rows, width, height)
        ctx.save_for_backward(geometry, features, state.sums)
        return state.image()

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        geometry, features, sums = ctx.saved_tensors
        state = _Blender(geometry, features, *ctx.size, ctx.config)
        gradients = _replay(state, ctx.chunks, sums, state.tiled(grad))
        return gradients[:-1, :6], gradients[:-1, 6:], None, None, None, None


def _chunks(splat, tiles, start, length, padding: int, state: _Blender, config) -> Iterator[tuple[Tensor, Tensor]]:
    """Yields (tiles (t,), splats (t, K)): `chunk` list positions of a batch of tiles at a time, front to back, for as
    long as the tile has a live pixel. A list that ends is filled up with the index `padding`."""
    steps = torch.arange(config.chunk, device=splat.device)
    batch = max(1, config.batch // (config.chunk * config.tile_size**2))
    for group in torch.arange(len(tiles), device=splat.device).split(batch):
        position = 0
        while len(group):
            listed = (length[group] - position)[:, None]
            index = (start[group] + position)[:, None] + steps
            chosen = splat[index.clamp(max=len(splat) - 1)]
            yield tiles[group], torch.where(steps < listed, chosen, padding)
            position += config.chunk
            alive = state.alive(tiles[group]) & (length[group] > position)
            group = group[alive]


class _Blender:
    """The pixels' running state, laid out as (pixel of the tile, tile)."""

    def __init__(self, geometry: Tensor, features: Tensor, columns: int, rows: int, width: int, height: int, config):
        self.columns, self.rows, self.width, self.height, self.side = columns, rows, width, height, config.tile_size
        # one more row for `padding`: an exponent so low that it is skipped everywhere
        self.geometry = torch.cat([geometry, geometry.new_tensor([[0, 0, 0, 0, 0, -1e4]])])
        self.features = torch.cat(
            [features, torch.zeros_like(features[:1])]
            if len(features)
            else [features.new_zeros((1, features.shape[1]))]
        )
        self.monomials = _monomials(self.side, geometry.dtype, geometry.device)
        inside = self.tiled(geometry.new_ones((height, width, 1)))[..., 0]
        self.transmittance = inside.clone()  # 0 beyond the border: such a pixel has stopped before it began
        self.sums = geometry.new_zeros((*inside.shape, features.shape[1]))
        # `threshold` keeps what is above its bound, the rule keeps what is not below ALPHA_MIN
        least = torch.tensor(ALPHA_MIN, dtype=geometry.dtype)
        self.below_least = torch.nextafter(least, torch.zeros_like(least)).item()

    def tiled(self, image: Tensor) -> Tensor:
        """(H, W, C) -> (P, tiles, C), zero beyond the border."""
        side, channels = self.side, image.shape[2]
        padded = image.new_zeros((self.rows * side, self.columns * side, channels))
        padded[: self.height, : self.width] = image
        blocks = padded.view(self.rows, side, self.columns, side, channels).permute(1, 3, 0, 2, 4)
        return blocks.reshape(side * side, self.rows * self.columns, channels)

    def image(self) -> Tensor:
        """(H, W, F) of the sums so far."""
        blocks = self.sums.view(self.side, self.side, self.rows, self.columns, -1).permute(2, 0, 3, 1, 4)
        padded = blocks.reshape(self.rows * self.side, self.columns * self.side, -1)
        return padded[: self.height, : self.width].contiguous()

    def alive(self, tiles: Tensor | None = None) -> Tensor:
        """Whether any pixel of each tile has not stopped."""
        transmittance = self.transmittance if tiles is None else self.transmittance[:, tiles]
        return (transmittance >= TRANSMITTANCE_STOP).any(0)

    def offsets(self, tiles: Tensor, geometry: Tensor) -> tuple[Tensor, Tensor]:
        """(t, K) splat centres relative to the tiles' centres, from (t, K, 6)."""
        x = (tiles % self.columns + 0.5) * self.side
        y = (tiles // self.columns + 0.5) * self.side
        return geometry[..., 0] - x[:, None], geometry[..., 1] - y[:, None]

    def responses(self, tiles: Tensor, geometry: Tensor) -> Tensor:
        """(P, t, K) opacity x Gaussian, not clamped, 0 where it is below ALPHA_MIN."""
        dx, dy = self.offsets(tiles, geometry)
        _, _, xx, xy, yy, log_opacity = geometry.unbind(-1)
        along_x, along_y = xx * dx + xy * dy, xy * dx + yy * dy
        constant = log_opacity - 0.5 * (along_x * dx + along_y * dy)
        coefficients = torch.stack([-0.5 * xx, -xy, -0.5 * yy, along_x, along_y, constant])
        exponent = (self.monomials @ coefficients.view(6, -1)).view(-1, *dx.shape)
        return torch.nn.functional.threshold_(exponent.exp_(), self.below_least, 0.0)

    def weights(self, alpha: Tensor, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(weight, transmittance in front, transmittance behind), (P, t, K) each, from alpha and the transmittance
        `before` (P, t). Behind the stop the transmittance goes on falling, which marks the pixel as stopped."""
        through = 1 - alpha
        through[..., 0] *= before
        behind = through.cumprod_(-1)
        front = torch.cat([before[..., None], behind[..., :-1]], -1)
        return alpha.mul(front).mul_(behind >= TRANSMITTANCE_STOP), front, behind

    def add(self, tiles: Tensor, splats: Tensor) -> None:
        """Blend the (t, K) splats behind what the tiles hold."""
        geometry, features = _rows(self.geometry, splats), _rows(self.features, splats)
        alpha = self.responses(tiles, geometry).clamp_(max=ALPHA_MAX)
        weight, _, behind = self.weights(alpha, self.transmittance[:, tiles])
        self.sums[:, tiles] += torch.bmm(weight.transpose(0, 1), features).transpose(0, 1)
        self.transmittance[:, tiles] = behind[..., -1]


def _rows(table: Tensor, index: Tensor) -> Tensor:
    return table.index_select(0, index.reshape(-1)).view(*index.shape, -1)


def _replay(state: _Blender, chunks, sums: Tensor, grad: Tensor) -> Tensor:
    """(M + 1, 6 + F) gradients by geometry and features, from `sums` and their gradient `grad`, (P, tiles, F) each."""
    remaining = (sums * grad).sum(-1)
    gradients = torch.zeros_like(torch.cat([state.geometry, state.features], 1))
    for tiles, splats, before in chunks:
        geometry, features = _rows(state.geometry, splats), _rows(state.features, splats)
        response = state.responses(tiles, geometry)
        alpha = response.clamp(max=ALPHA_MAX)
        weight, front, behind = state.weights(alpha, before)
        grad_pixel = grad[:, tiles].transpose(0, 1)
        grad_weight = torch.bmm(grad_pixel, features.transpose(1, 2)).transpose(0, 1)
        grad_features = torch.bmm(weight.permute(1, 2, 0), grad_pixel)
        left = remaining[:, tiles, None] - (weight * grad_weight).cumsum(-1)
        remaining[:, tiles] = left[..., -1]
        # through the clamp as if it were not there: d alpha / d exponent is the unclamped response
        grad_exponent = front.mul_(grad_weight).sub_(left.div_(1 - alpha)).mul_(response)
        grad_exponent.mul_(behind >= TRANSMITTANCE_STOP)
        grad_geometry = _geometry_gradient(state, tiles, geometry, grad_exponent)
        rows = torch.cat([grad_geometry, grad_features], -1)
        gradients.index_add_(0, splats.reshape(-1), rows.view(-1, rows.shape[-1]))
    return gradients


def _geometry_gradient(state: _Blender, tiles: Tensor, geometry: Tensor, grad_exponent: Tensor) -> Tensor:
    """(t, K, 6): the chain rule through `_Blender.responses`' polynomial."""
    dx, dy = state.offsets(tiles, geometry)
    _, _, xx, xy, yy, _ = geometry.unbind(-1)
    flat = state.monomials.T @ grad_exponent.reshape(grad_exponent.shape[0], -1)
    g_xx, g_xy, g_yy, g_x, g_y, g_1 = flat.view(6, *dx.shape)
    moment_x, moment_y = g_x - g_1 * dx, g_y - g_1 * dy  # of the pixel's offset from the splat's centre
    return torch.stack(
        [
            xx * moment_x + xy * moment_y,
            xy * moment_x + yy * moment_y,
            -0.5 * (g_xx - g_x * dx - moment_x * dx),
            -(g_xy - g_x * dy - moment_y * dx),
            -0.5 * (g_yy - g_y * dy - moment_y * dy),
            g_1,
        ],
        -1,
    )
