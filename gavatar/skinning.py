"""Linear blend skinning of points, and of what has a direction, in torch."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from .rotations import quaternion_from_matrix, quaternion_product


def dense_weights(joint_index: np.ndarray, joint_weight: np.ndarray, num_joints: int) -> np.ndarray:
    """(N, J) matrix of the sparse weights (N, K). A dense product with the joints' transforms is one matrix multiply
    forward and backward, which on a CPU beats gathering per point (and scattering per joint in the backward)."""
    dense = np.zeros((len(joint_index), num_joints), joint_weight.dtype)
    np.add.at(dense, (np.arange(len(joint_index))[:, None], joint_index), joint_weight)
    return dense


def skin(points: Tensor, weights: Tensor, transforms: Tensor) -> Tensor:
    """points: (..., N, 3) in the frame the transforms map from, metres. weights: (N, J). transforms: (..., J, 3, 4).
    Returns (..., N, 3). The blended matrix is not rigid in general (SMPL, Loper et al. 2015, equation 7)."""
    blended = (weights @ transforms.flatten(-2)).unflatten(-1, (3, 4))
    return (blended[..., :3] @ points[..., None])[..., 0] + blended[..., 3]


def skin_rotations(rotations: Tensor, weights: Tensor, transforms: Tensor, parents: list[int]) -> Tensor:
    """What skinning turns the points by, after rotations of their own.

    rotations: (..., N, 4) wxyz in the frame the transforms map from. weights: (N, J). transforms: (..., J, 3, 4).
    parents: -1 for the root, before their children. Returns (..., N, 4) wxyz, of unit length.

    The blended matrix of a point is not a rotation; the nearest one is approached by the weighted mean of its joints'
    quaternions (Kavan et al. 2007, section 4). A joint's sign follows its parent's, so that neighbours never cancel.
    """
    joints: list[Tensor] = []
    for joint, parent in zip(quaternion_from_matrix(transforms[..., :3]).unbind(-2), parents, strict=True):
        if parent >= 0:
            joint = torch.where((joint * joints[parent]).sum(-1, keepdim=True) < 0, -joint, joint)
        joints.append(joint)
    carried = F.normalize(weights @ torch.stack(joints, -2), dim=-1)
    return F.normalize(quaternion_product(carried, rotations), dim=-1)


def skinning_weights(surface, num_joints: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """(N, J) dense weights of a sampled surface."""
    return torch.as_tensor(dense_weights(surface.joint_index, surface.joint_weight, num_joints), dtype=dtype)
