"""Rotations in torch with gradients that are right everywhere: at zero, at pi and beyond.

NumPy's half is `gavatar_runtime.geometry.rotations`; a test holds the two together.
"""

from __future__ import annotations

import torch
from torch import Tensor


def matrix_from_axis_angle(axis_angle: Tensor) -> Tensor:
    """(..., 3) radians -> (..., 3, 3) rotation matrices (Rodrigues' formula, R = I + a K + b K^2).

    a = sin(t)/t and b = (1 - cos t)/t^2 = (sin(t/2)/(t/2))^2 / 2 are smooth functions of t^2; below t^2 = 1e-4 their
    Taylor series is used (truncation below 1e-13 relative), so value and gradient are exact at zero and no epsilon
    enters anywhere. At t = pi nothing is singular: the axis is the input's own. float16 and bfloat16 are computed in
    float32: their squares of angles end at 256 and hold two or three digits.
    """
    if axis_angle.dtype in (torch.float16, torch.bfloat16):
        return matrix_from_axis_angle(axis_angle.float()).to(axis_angle.dtype)
    t2 = (axis_angle * axis_angle).sum(-1)[..., None, None]
    small = t2 < 1e-4
    t = torch.sqrt(torch.where(small, torch.ones_like(t2), t2))
    half = torch.sin(t / 2) / t
    a = torch.where(small, 1 - t2 / 6 * (1 - t2 / 20), torch.sin(t) / t)
    b = torch.where(small, 0.5 - t2 / 24 * (1 - t2 / 30), 2 * half * half)
    x, y, z = axis_angle.unbind(-1)
    zero = torch.zeros_like(x)
    K = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + a * K + b * (K @ K)


def rotation_vector_from_matrix(matrix: Tensor) -> Tensor:
    """(..., 3, 3) rotations -> (..., 3) rotation vectors with angle in [0, pi], radians.

    Through the quaternion and atan2: value and gradient are finite everywhere, exact at zero. At pi the axis' sign is a
    choice and the function jumps, as it must.
    """
    q = quaternion_from_matrix(matrix)
    w, v = q[..., :1], q[..., 1:]
    v2 = (v * v).sum(-1, keepdim=True)
    small = v2 < 1e-6
    sine = torch.sqrt(torch.where(small, torch.ones_like(v2), v2))
    x2 = v2 / torch.where(small, w, torch.ones_like(w)).square()
    series = 2 / torch.where(small, w, torch.ones_like(w)) * (1 - x2 / 3 * (1 - x2 * 3 / 5))
    return v * torch.where(small, series, 2 * torch.atan2(sine, w) / sine)


def quaternion_from_matrix(matrix: Tensor) -> Tensor:
    """(..., 3, 3) rotations -> (..., 4) unit quaternions wxyz, w >= 0, by way of their largest component (Shepperd),
    which is never near zero."""
    m00, m11, m22 = (matrix[..., i, i] for i in range(3))
    d21, d02, d10 = (matrix[..., i, j] - matrix[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    s01, s02, s12 = (matrix[..., i, j] + matrix[..., j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    rows = [
        [1 + m00 + m11 + m22, d21, d02, d10],
        [d21, 1 + m00 - m11 - m22, s01, s02],
        [d02, s01, 1 - m00 + m11 - m22, s12],
        [d10, s02, s12, 1 - m00 - m11 + m22],
    ]
    candidates = torch.stack([torch.stack(row, -1) for row in rows], -2)
    best = candidates.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None].expand(*matrix.shape[:-2], 1, 4)
    q = candidates.gather(-2, best)[..., 0, :]
    q = q / q.norm(dim=-1, keepdim=True)
    return torch.where(q[..., :1] < 0, -q, q)


def quaternion_product(a: Tensor, b: Tensor) -> Tensor:
    """(..., 4) wxyz: the rotation b, then a."""
    a, b = torch.broadcast_tensors(a, b)
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    dot = (av * bv).sum(-1, keepdim=True)
    return torch.cat([aw * bw - dot, aw * bv + bw * av + torch.linalg.cross(av, bv)], -1)
