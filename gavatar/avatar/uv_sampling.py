"""Sampling of UV maps at the points of a surface: the same few texels for every point, step after step."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from gavatar_runtime import native_library as nl


def sample_uv(maps: Tensor, uv: Tensor) -> Tensor:
    """maps: (B, C, R, R). uv: (N, 2) in [0, 1], v down -> (B, N, C), bilinear, texel centres at (i + 0.5)/R, the edge
    texel continuing outwards (upstream pads with zero, which darkens the atlas' border)."""
    grid = (2 * uv - 1)[None, None].expand(len(maps), -1, -1, -1)
    return F.grid_sample(maps, grid, padding_mode="border", align_corners=False)[:, :, 0].transpose(1, 2)


def bilinear(uv: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The four texels, (N, 4) int64 row x size + column, and weights, (N, 4) float32, by which `sample_uv` reads a map
    of `size` x `size` texels, at least 2, at uv (N, 2)."""
    x, y = np.clip(np.asarray(uv, np.float64) * size - 0.5, 0, size - 1).T
    column, row = np.minimum(x.astype(np.int64), size - 2), np.minimum(y.astype(np.int64), size - 2)
    a, b = x - column, y - row
    corner = np.stack([row * size + column + d for d in (0, 1, size, size + 1)], -1)
    weight = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], -1)
    return corner, weight.astype(np.float32)


class Sampler:
    """`sample_uv` at points that stay: where the kernel takes the maps (float32 on the CPU), the texels of each point
    are found once for each size of maps, and sampling is a sparse product, as is its gradient. uv: (N, 2)."""

    def __init__(self, uv: np.ndarray):
        self._uv = uv
        self._plans: dict[int, _Plan] = {}

    def __call__(self, maps: Tensor, uv: Tensor) -> Tensor:
        """maps: (B, C, R, R). uv: the points again, where the maps are -> (B, N, C)."""
        if maps.shape[-1] < 2 or maps.device.type != "cpu" or maps.dtype != torch.float32 or not nl.available()[0]:
            return sample_uv(maps, uv)
        size = maps.shape[-1]
        if size not in self._plans:
            self._plans[size] = _Plan(self._uv, size)
        return _Sample.apply(maps, self._plans[size])


class _Plan:
    """The matrix of sampling, (N, R^2), up to four entries a row, and its transpose, as offsets, columns, values."""

    def __init__(self, uv: np.ndarray, size: int):
        texels, weights = bilinear(uv, size)
        # a point on a texel's centre, as all are where the atlas has the maps' size, is that texel alone
        used = weights > 1e-6
        points = np.broadcast_to(np.arange(len(uv))[:, None], used.shape)[used]
        texels, weights = texels[used], weights[used]
        self.forward = _rows(points, texels, weights, len(uv))
        order = np.argsort(texels, kind="stable")
        self.backward = _rows(texels[order], points[order], weights[order], size * size)


def _rows(rows: np.ndarray, columns: np.ndarray, values: np.ndarray, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Compressed rows: (count + 1,) offsets, columns and values of entries sorted by row."""
    offsets = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=count))])
    ints = [torch.as_tensor(np.ascontiguousarray(x, np.int32)) for x in (offsets, columns)]
    return ints[0], ints[1], torch.as_tensor(np.ascontiguousarray(values, np.float32))


def _product(matrix: tuple[Tensor, Tensor, Tensor], table: Tensor) -> Tensor:
    """(B, n, C) contiguous -> (B, rows, C)."""
    count = len(matrix[0]) - 1
    out = table.new_empty(len(table), count, table.shape[2])
    for source, to in zip(table, out, strict=True):
        pointers = (x.data_ptr() for x in (*matrix, source, to))
        nl.check(nl.library().gv_sparse_product(count, table.shape[2], table.shape[1], *pointers))
    return out


class _Sample(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, maps: Tensor, plan: _Plan) -> Tensor:
        ctx.plan, ctx.shape = plan, maps.shape
        # free of copies for maps in memory_format channels_last
        return _product(plan.forward, maps.permute(0, 2, 3, 1).flatten(1, 2).contiguous())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        B, C, H, W = ctx.shape
        return _product(ctx.plan.backward, grad.contiguous()).view(B, H, W, C).permute(0, 3, 1, 2), None
