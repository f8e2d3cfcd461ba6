"""Bodies in training: the protocol a body component fulfils, and its kinematics in torch.

The numbers live in `gavatar_runtime.body.BodyData`; NumPy kinematics in `gavatar_runtime.kinematics` are the tested
reference of the functions here.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.body import SMPL_BODY_JOINTS, BodyData

from .rotations import matrix_from_axis_angle

__all__ = ["SMPL_BODY_JOINTS", "Body", "BodyData", "Skeleton", "joint_transforms"]


class Body(Protocol):
    """A component of the `body` registry: where a body's numbers come from."""

    data: BodyData
    license: str


def joint_transforms(rotations: Tensor, joints: Tensor, parents: list[int]) -> tuple[Tensor, Tensor]:
    """World rotation and position of every joint.

    rotations: (..., J, 3, 3) local. joints: (J, 3) or (..., J, 3) rest positions, metres. parents: -1 for the root.
    Returns (..., J, 3, 3) and (..., J, 3), without the global translation (SMPL, Loper et al. 2015, equation 3).
    """
    R: list[Tensor] = []
    p: list[Tensor] = []
    for j, parent in enumerate(parents):
        if parent < 0:
            R.append(rotations[..., j, :, :])
            p.append(joints[..., j, :].expand(*rotations.shape[:-3], 3))
        else:
            bone = joints[..., j, :] - joints[..., parent, :]
            R.append(R[parent] @ rotations[..., j, :, :])
            p.append((R[parent] @ bone[..., None])[..., 0] + p[parent])
    return torch.stack(R, -3), torch.stack(p, -2)


class Skeleton(torch.nn.Module):
    """The differentiable skeleton of one person: rest joints of a shape, parents, canonical pose.

    data: the body. betas: (B,) shape coefficients or None.
    """

    def __init__(self, data: BodyData, betas: np.ndarray | None = None, dtype: torch.dtype = torch.float32):
        super().__init__()
        self.parents = [int(p) for p in data.parents]
        _, joints = data.shaped(betas)
        canonical = torch.as_tensor(data.canonical_pose(), dtype=dtype)
        self.register_buffer("joints", torch.as_tensor(joints, dtype=dtype), persistent=False)
        A_rot, A_trans = self.skinning(matrix_from_axis_angle(canonical))
        self.register_buffer("_canonical_rot_inv", A_rot.transpose(-1, -2).contiguous(), persistent=False)
        self.register_buffer("_canonical_trans", A_trans, persistent=False)

    def posed_joints(self, rotations: Tensor) -> Tensor:
        """(..., J, 3, 3) local rotations -> (..., J, 3) joint positions, metres, without translation."""
        return joint_transforms(rotations, self.joints, self.parents)[1]

    def skinning(self, rotations: Tensor) -> tuple[Tensor, Tensor]:
        """Rest-to-posed skinning transforms: (..., J, 3, 3) linear part and (..., J, 3) offset."""
        R, p = joint_transforms(rotations, self.joints, self.parents)
        return R, p - (R @ self.joints[..., None])[..., 0]

    def canonical_to_posed(self, rotations: Tensor) -> Tensor:
        """(..., J, 3, 4) transforms from the canonical pose to the pose: A_live A_canonical^-1, inverted rigidly."""
        R, t = self.skinning(rotations)
        linear = R @ self._canonical_rot_inv
        offset = t - (linear @ self._canonical_trans[..., None])[..., 0]
        return torch.cat([linear, offset[..., None]], -1)
