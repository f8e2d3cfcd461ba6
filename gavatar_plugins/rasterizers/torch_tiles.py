"""The differentiable reference rasterizer in plain torch: exact to `gavatar_runtime.splatting_rule`, any
device.

A frame goes through four steps:

1. `project` turns Gaussians into screen ellipses (`Splats`); ordinary autograd differentiates it.
2. `TileLists` writes down, front to back, which splats touch which tile.
3. `_Blend` walks the lists, many tiles at a time and `chunk` list positions at a time, and forgets a tile as soon as
   all of its pixels have stopped. With opaque Gaussians that is after some hundred of them, whatever lies behind.
4. The backward pass replays the same chunks. With weights w_j and s_j = dL/dw_j, the derivative by the opacity of the
   i-th splat of a pixel is `T_i s_i - (sum_{j>i} w_j s_j) / (1 - alpha_i)`, and the sum is what remains of the pixel's
   total, so one pass front to back suffices.

Inside a tile the exponent of a splat is a quadratic polynomial of the pixel's position, hence one matrix product of six
coefficients a splat with six monomials a pixel, forward and backward. Arrays of steps 3 and 4 are laid out as
(pixel of the tile, tile, list position).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gavatar.protocols import Background, Rasterizer
from gavatar.registry import RASTERIZERS
from gavatar_runtime.errors import UserError
from gavatar_runtime.splatting_rule import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_STOP
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering

from .torch_projection import FIELDS, check_dtype, finite_mask, pixel_bounds, project, visible_in_order


@dataclasses.dataclass
class TorchRasterizerConfig:
    """tile_size: pixels on a side. chunk: list positions blended at once. slab: (splat, tile) pairs listed at once.
    batch: (pixel, splat) pairs evaluated at once.

    None of them changes the picture; slab and batch bound the memory. The defaults are the fastest measured on two
    CPU cores.
    """

    tile_size: int = 4
    chunk: int = 32
    slab: int = 1 << 18
    batch: int = 1 << 20

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if getattr(self, field.name) < 1:
                raise UserError(f"rasterizer.{field.name} must be at least 1, got {getattr(self, field.name)}")


@RASTERIZERS.register("torch", config=TorchRasterizerConfig, summary="exact, differentiable, plain torch on any device")
class TorchRasterizer(Rasterizer):
    """Exact splatting with torch tensors, of float32 or float64 on any device."""

    def __init__(self, config: TorchRasterizerConfig):
        self.config = config

    def __call__(self, gaussians: Gaussians, camera: Camera, background: Background = (1.0, 1.0, 1.0)) -> Rendering:
        check_dtype(gaussians)
        with torch.no_grad():
            finite = finite_mask(gaussians)
            visible = visible_in_order(project(gaussians, camera), finite, camera)
        seen = _select(gaussians, visible)
        splats = project(seen, camera)
        geometry = [splats.xy, splats.conic, splats.log_opacity[:, None]]
        features = [seen.colors, splats.depth[:, None], torch.ones_like(splats.depth[:, None])]
        blended = _Blend.apply(torch.cat(geometry + features, 1), splats.extent.detach(), camera, self.config)
        alpha = blended[..., 4]
        background = torch.as_tensor(background, dtype=alpha.dtype, device=alpha.device)
        color = blended[..., :3] + (1 - alpha)[..., None] * background
        return Rendering(color, alpha, blended[..., 3], dropped=len(finite) - int(finite.sum()))


def _select(gaussians: Gaussians, index: Tensor) -> Gaussians:
    values = (getattr(gaussians, name) for name in FIELDS)
    return Gaussians(*(None if value is None else value.index_select(0, index) for value in values))


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
        count = -(-total // self.slab)
        marks = torch.arange(1, max(count, 1), device=pairs.device) * total // max(count, 1)
        edges = [0, *torch.searchsorted(pairs, marks).tolist(), len(pairs)]
        return (slice(start, stop) for start, stop in itertools.pairwise(edges) if stop > start)

    def lists(self, run: slice, alive: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The lists of the splats `run` in the tiles where `alive` (rows * columns,) holds.

        Returns splat (L,) indices, tile after tile and front to back in each, and for the T tiles with any:
        their number (T,), the start of their list (T,) and its length (T,).
        """
        everywhere = bool(alive.all())
        splat, first, size = self._with_live_tiles(run, alive, everywhere)
        # a splat covers some rows of tiles, and a row some consecutive tiles
        row, row_step = _ragged_ranges(size[:, 1])
        row_tile = (first[:, 1].index_select(0, row) + row_step) * self.columns + first[:, 0].index_select(0, row)
        pair, tile_step = _ragged_ranges(size[:, 0].index_select(0, row))
        tile = row_tile.index_select(0, pair) + tile_step
        if not everywhere:
            kept = alive.index_select(0, tile).nonzero()[:, 0]
            pair, tile = pair.index_select(0, kept), tile.index_select(0, kept)
        # the pairs stand in depth order, so a stable sort by tile leaves each tile's list in depth order
        length = torch.bincount(tile, minlength=len(alive))
        _, order = torch.sort(tile.to(torch.int16 if len(alive) < 1 << 15 else torch.int32), stable=True)
        splat = splat.index_select(0, row.index_select(0, pair.index_select(0, order)))
        tiles = length.nonzero()[:, 0]
        return splat, tiles, (length.cumsum(0) - length)[tiles], length[tiles]

    def _with_live_tiles(self, run: slice, alive: Tensor, everywhere: bool) -> tuple[Tensor, Tensor, Tensor]:
        """(index, first tile, size in tiles) of the splats of `run` whose rectangle holds a live tile."""
        first, size = self.first[run], self.size[run]
        index = torch.arange(run.start, run.stop, device=alive.device)
        if everywhere:
            return index, first, size
        area = alive.new_zeros((self.rows + 1, self.columns + 1), dtype=torch.long)  # a summed-area table
        area[1:, 1:] = alive.view(self.rows, self.columns).long().cumsum(0).cumsum(1)
        (x0, y0), (x1, y1) = first.unbind(1), (first + size).unbind(1)
        kept = (area[y1, x1] - area[y0, x1] - area[y1, x0] + area[y0, x0] > 0).nonzero()[:, 0]
        return index[kept], first[kept], size[kept]


def _ragged_ranges(lengths: Tensor) -> tuple[Tensor, Tensor]:
    """For ranges of the given (n,) lengths laid end to end: whose each element is, and its position in the range."""
    owner = torch.repeat_interleave(lengths)
    start = lengths.cumsum(0) - lengths
    return owner, torch.arange(len(owner), device=lengths.device) - start.index_select(0, owner)


class _Blend(torch.autograd.Function):
    """Front-to-back blending: table (M, 6 + F) of splats in depth order -> (H, W, F) sums of weight x feature.

    A row holds x, y, the conic's xx, xy, yy, the log opacity, and F features.
    """

    @staticmethod
    def forward(ctx: Any, table: Tensor, extent: Tensor, camera: Camera, config: TorchRasterizerConfig) -> Tensor:
        lists = TileLists(table[:, :2], extent, camera.width, camera.height, config)
        blender = _Blender(table, lists.columns, lists.rows, camera, config)
        chunks = []
        for run in lists.slabs():
            alive = blender.alive()
            if not alive.any():
                break
            for tiles, splats in _chunks(*lists.lists(run, alive), blender, config):
                chunks.append((tiles, splats, blender.add(tiles, splats)))
        ctx.chunks, ctx.camera, ctx.config, ctx.tiles = chunks, camera, config, (lists.columns, lists.rows)
        ctx.save_for_backward(table, blender.sums)
        return blender.image()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None, None]:
        table, sums = ctx.saved_tensors
        columns, rows = ctx.tiles
        blender = _Blender(table, columns, rows, ctx.camera, ctx.config)
        return _replay(blender, ctx.chunks, sums, blender.tiled(grad)), None, None, None


def _chunks(
    splat: Tensor, tiles: Tensor, start: Tensor, length: Tensor, blender: _Blender, config: TorchRasterizerConfig
) -> Iterator[tuple[Tensor, Tensor]]:
    """Yields (tiles (t,), splats (t, K)): `chunk` list positions of a batch of tiles at a time, front to back, for as
    long as the tile has a live pixel. A list that ends is filled up with `blender.padding`."""
    steps = torch.arange(config.chunk, device=splat.device)
    batch = max(1, config.batch // (config.chunk * config.tile_size**2))
    for group in torch.arange(len(tiles), device=splat.device).split(batch):
        position = 0
        while len(group):
            index = (start[group] + position)[:, None] + steps
            chosen = splat.take(index.clamp(max=len(splat) - 1))
            yield tiles[group], torch.where(steps < (length[group] - position)[:, None], chosen, blender.padding)
            position += config.chunk
            group = group[length[group] > position]
            group = group[blender.alive(tiles[group])]


class _Blender:
    """The pixels' running state, laid out as (pixel of the tile, tile)."""

    def __init__(self, table: Tensor, columns: int, rows: int, camera: Camera, config: TorchRasterizerConfig):
        self.columns, self.rows, self.side = columns, rows, config.tile_size
        self.width, self.height = camera.width, camera.height
        # one more row, to pad lists with: an exponent so low that it is skipped everywhere
        self.padding = len(table)
        self.table = torch.cat([table, table.new_zeros((1, table.shape[1]))])
        self.table[-1, 5] = -1e4
        self.monomials = _monomials(self.side, table.dtype, table.device)
        inside = self.tiled(table.new_ones((camera.height, camera.width, 1)))[..., 0]
        self.transmittance = inside.clone()  # 0 beyond the border: such a pixel has stopped before it began
        self.sums = table.new_zeros((*inside.shape, table.shape[1] - 6))
        # `threshold` keeps what is above its bound, the rule keeps what is not below ALPHA_MIN
        least = torch.tensor(ALPHA_MIN, dtype=table.dtype)
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
        transmittance = self.transmittance if tiles is None else self.transmittance.index_select(1, tiles)
        return transmittance.amax(0) >= TRANSMITTANCE_STOP

    def rows_of(self, splats: Tensor) -> Tensor:
        """(t, K, 6 + F) the table's rows."""
        return self.table.index_select(0, splats.view(-1)).view(*splats.shape, -1)

    def offsets(self, tiles: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """(t, K) each: splat centres relative to the tiles' centres, pixels."""
        x = (tiles % self.columns + 0.5) * self.side
        y = (tiles // self.columns + 0.5) * self.side
        return rows[..., 0] - x[:, None], rows[..., 1] - y[:, None]

    def responses(self, tiles: Tensor, rows: Tensor) -> Tensor:
        """(P, t, K) opacity x Gaussian, not clamped, 0 where it is below ALPHA_MIN."""
        dx, dy = self.offsets(tiles, rows)
        xx, xy, yy, log_opacity = rows[..., 2:6].unbind(-1)
        along_x, along_y = xx * dx + xy * dy, xy * dx + yy * dy
        constant = log_opacity - 0.5 * (along_x * dx + along_y * dy)
        coefficients = torch.stack([-0.5 * xx, -xy, -0.5 * yy, along_x, along_y, constant])
        exponent = (self.monomials @ coefficients.view(6, -1)).view(-1, *dx.shape)
        # exp is several times slower where it underflows; -10 is below log(ALPHA_MIN) already
        return torch.threshold_(exponent.clamp_(min=-10).exp_(), self.below_least, 0.0)

    def weights(self, alpha: Tensor, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """From alpha (P, t, K) and the transmittance `before` (P, t) the transmittance in front of each splat, 1 or 0
        for blended or stopped, and the transmittance behind all, which goes on falling after the stop."""
        passing = alpha.new_empty((*before.shape, alpha.shape[2] + 1))
        passing[..., 0] = before
        torch.sub(1, alpha, out=passing[..., 1:])
        passing = passing.cumprod(-1)
        front, behind = passing[..., :-1], passing[..., 1:]
        return front, torch.ge(behind, TRANSMITTANCE_STOP, out=torch.empty_like(alpha)), behind[..., -1]

    def add(self, tiles: Tensor, splats: Tensor) -> Tensor:
        """Blend the (t, K) splats behind what the tiles hold; returns the transmittance (P, t) there was before."""
        rows = self.rows_of(splats)
        alpha = self.responses(tiles, rows).clamp_(max=ALPHA_MAX)
        before = self.transmittance.index_select(1, tiles)
        front, blended, behind = self.weights(alpha, before)
        weight = alpha.mul_(front).mul_(blended)
        self.sums[:, tiles] += torch.bmm(weight.transpose(0, 1), rows[..., 6:]).transpose(0, 1)
        self.transmittance.index_copy_(1, tiles, behind)
        return before


@functools.lru_cache(maxsize=8)
def _monomials(tile_size: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """(P, 6): x^2, xy, y^2, x, y, 1 at the pixel centres, relative to the tile's centre."""
    steps = torch.arange(tile_size, dtype=dtype, device=device) + 0.5 - tile_size / 2
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    x, y = x.reshape(-1), y.reshape(-1)
    return torch.stack([x * x, x * y, y * y, x, y, torch.ones_like(x)], 1)


def _replay(blender: _Blender, chunks: list[tuple[Tensor, Tensor, Tensor]], sums: Tensor, grad: Tensor) -> Tensor:
    """(M, 6 + F) gradient by the table, from the forward's `sums` and their gradient `grad`, (P, tiles, F) each."""
    remaining = (sums * grad).sum(-1)
    gradient = torch.zeros_like(blender.table)
    for tiles, splats, before in chunks:
        rows = blender.rows_of(splats)
        response = blender.responses(tiles, rows)
        alpha = response.clamp(max=ALPHA_MAX)
        front, blended, _ = blender.weights(alpha, before)
        weight = (front * alpha).mul_(blended)
        features = rows[..., 6:].permute(2, 0, 1).contiguous()
        grads = grad.index_select(1, tiles)[..., None, :].unbind(-1)
        grad_weight = grads[0] * features[0]
        for upstream, feature in zip(grads[1:], features[1:], strict=True):
            grad_weight.addcmul_(upstream, feature)
        grad_features = [(weight * upstream).sum(0) for upstream in grads]
        left = torch.sub(remaining.index_select(1, tiles)[..., None], weight.mul_(grad_weight).cumsum(-1))
        remaining.index_copy_(1, tiles, left[..., -1])
        # through the clamp as if it were not there: d alpha / d exponent is the unclamped response
        grad_exponent = grad_weight.mul_(front).sub_(left.div_(alpha.neg_().add_(1))).mul_(response).mul_(blended)
        grads_table = torch.stack([*_geometry_gradients(blender, tiles, rows, grad_exponent), *grad_features], -1)
        gradient.index_add_(0, splats.view(-1), grads_table.view(-1, grads_table.shape[-1]))
    return gradient[:-1]


def _geometry_gradients(blender: _Blender, tiles: Tensor, rows: Tensor, grad_exponent: Tensor) -> tuple[Tensor, ...]:
    """(t, K) for each of x, y, xx, xy, yy, log opacity: the chain rule through the polynomial of `responses`."""
    dx, dy = blender.offsets(tiles, rows)
    xx, xy, yy = rows[..., 2:5].unbind(-1)
    moments = blender.monomials.T @ grad_exponent.view(len(grad_exponent), -1)
    g_xx, g_xy, g_yy, g_x, g_y, g_1 = moments.view(6, *dx.shape)
    from_x, from_y = g_x - g_1 * dx, g_y - g_1 * dy  # first moments about the splat's centre
    return (
        xx * from_x + xy * from_y,
        xy * from_x + yy * from_y,
        -0.5 * (g_xx - g_x * dx - from_x * dx),
        -(g_xy - g_x * dy - from_y * dx),
        -0.5 * (g_yy - g_y * dy - from_y * dy),
        g_1,
    )
