"""The rule of `reference_splat` once more, in float64 torch and dense (every Gaussian at every pixel), so that ordinary
autograd differentiates it. For small scenes."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.splatting_rule import ALPHA_MAX, ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, NEAR, TRANSMITTANCE_STOP
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering


def render(
    gaussians: Gaussians,
    camera: Camera,
    background: Tensor,
    *,
    alpha_max: float = ALPHA_MAX,
    through_clamp: bool = True,
) -> Rendering:
    """The picture from finite float64 tensors. through_clamp: gradients pass the clamp of alpha as if it were not
    there, which is the rule, or stop at it."""
    R, t = (torch.as_tensor(np.ascontiguousarray(part)) for part in np.split(camera.T_camera_world[:3], [3], 1))
    points = gaussians.means @ R.T + t[:, 0]
    order = torch.argsort(points[:, 2].detach().float(), stable=True)
    order = order[points[order, 2] > NEAR]
    points, colors = points[order], gaussians.colors[order]
    x, y, z = points.unbind(1)
    center = torch.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)
    rows, columns = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
    pixels = torch.stack([columns, rows], -1).view(-1, 2).double()
    offset = pixels[None] - center[:, None]
    conic = torch.linalg.inv(_covariances(gaussians, order, points, R, camera))
    response = torch.exp(-0.5 * torch.einsum("npi,nij,npj->np", offset, conic, offset))
    if gaussians.opacities is not None:
        response = response * gaussians.opacities[order, None]
    alpha = response.clamp(max=alpha_max)
    if through_clamp:
        alpha = response + (alpha - response).detach()
    alpha = torch.where(alpha >= ALPHA_MIN, alpha, 0)
    behind = (1 - alpha).cumprod(0)
    front = torch.cat([torch.ones_like(behind[:1]), behind[:-1]])
    weight = torch.where(behind.detach() >= TRANSMITTANCE_STOP, alpha * front, 0)
    opaque = weight.sum(0)
    color = weight.T @ colors + (1 - opaque)[:, None] * background
    shape = (camera.height, camera.width)
    return Rendering(color.view(*shape, 3), opaque.view(shape), (weight.T @ z).view(shape))


def _covariances(gaussians: Gaussians, order: Tensor, points: Tensor, R: Tensor, camera: Camera) -> Tensor:
    """(M, 2, 2) px^2 of the Gaussians `order`, low-pass included."""
    x, y, z = points.unbind(1)
    margin = FRUSTUM_MARGIN / 2
    u = (x / z).clamp(-(camera.cx + margin * camera.width) / camera.fx,
                      ((1 + margin) * camera.width - camera.cx) / camera.fx)  # fmt: skip
    v = (y / z).clamp(-(camera.cy + margin * camera.height) / camera.fy,
                      ((1 + margin) * camera.height - camera.cy) / camera.fy)  # fmt: skip
    nought = torch.zeros_like(z)
    J = torch.stack([camera.fx / z, nought, -camera.fx * u / z, nought, camera.fy / z, -camera.fy * v / z], 1)
    axes = torch.eye(3, dtype=torch.float64).expand(len(order), 3, 3)
    if gaussians.quaternions is not None:
        axes = _matrices(gaussians.quaternions[order])
    scales = gaussians.scales[order]
    axes = axes * (scales[:, None, None] if scales.ndim == 1 else scales[:, None, :])
    M = J.view(-1, 2, 3) @ R @ axes
    return M @ M.transpose(1, 2) + LOW_PASS * torch.eye(2, dtype=torch.float64)


def _matrices(quaternions: Tensor) -> Tensor:
    """(M, 3, 3): v -> v + 2 w (u x v) + 2 u x (u x v), with K v = u x v."""
    unit = quaternions / quaternions.norm(dim=1, keepdim=True)
    w, (x, y, z) = unit[:, :1, None], unit[:, 1:].unbind(1)
    nought = torch.zeros_like(x)
    K = torch.stack([nought, -z, y, z, nought, -x, -y, x, nought], 1).view(-1, 3, 3)
    return torch.eye(3, dtype=torch.float64) + 2 * w * K + 2 * K @ K
