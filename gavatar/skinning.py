"""Linear blend skinning of points in torch."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


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


def skinning_weights(surface, num_joints: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """(N, J) dense weights of a sampled surface."""
    return torch.as_tensor(dense_weights(surface.joint_index, surface.joint_weight, num_joints), dtype=dtype)
