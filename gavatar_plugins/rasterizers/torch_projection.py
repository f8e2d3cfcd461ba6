"""Projection of Gaussians to screen ellipses in torch, differentiable by ordinary autograd.

The first half of the rasterizer `torch` (`torch_tiles`), following `gavatar_runtime.splatting_rule`.
"""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor

from gavatar_runtime.errors import UserError
from gavatar_runtime.splatting_rule import ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, NEAR
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians

FIELDS = ("means", "scales", "colors", "opacities", "quaternions")


def check_dtype(gaussians: Gaussians) -> None:
    """UserError for halves: their pixel coordinates are a quarter of a pixel apart at 512."""
    for name in FIELDS:
        value = getattr(gaussians, name)
        if value is not None and value.dtype not in (torch.float32, torch.float64):
            raise UserError(
                f"rasterizers take float32 or float64, got gaussians.{name} of {value.dtype}: cast it first"
            )


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


def _covariance_isotropic(
    scales: Tensor, z: Tensor, ratio_x: Tensor, ratio_y: Tensor, camera: Camera
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """(xx, xy, yy, det) of s^2 J J^T, px^2."""
    k = (scales / z).square()
    kx, ky = k * camera.fx**2, k * camera.fy**2
    xx, yy = 1 + ratio_x.square(), 1 + ratio_y.square()
    cross = k * (camera.fx * camera.fy) * ratio_x * ratio_y
    return kx * xx, cross, ky * yy, kx * ky * (xx + ratio_y.square())


def _covariance(
    gaussians: Gaussians, z: Tensor, ratio_x: Tensor, ratio_y: Tensor, camera: Camera
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
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
