"""Rotations in torch with gradients that are right everywhere: at zero, at pi and beyond.

NumPy's half is `gavatar_runtime.rotations`; a test holds the two together.
"""

from __future__ import annotations

import torch
from torch import Tensor


def matrix_from_axis_angle(axis_angle: Tensor) -> Tensor:
    """(..., 3) radians -> (..., 3, 3) rotation matrices (Rodrigues' formula, R = I + a K + b K^2).

    a = sin(t)/t and b = (1 - cos t)/t^2 = (sin(t/2)/(t/2))^2 / 2 are smooth functions of t^2; below t^2 = 1e-4 their
    Taylor series is used (truncation below 1e-13 relative), so value and gradient are exact at zero and no epsilon
    enters anywhere. At t = pi nothing is singular: the axis is the input's own.
    """
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
