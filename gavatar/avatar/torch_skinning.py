"""Linear blend skinning of points, and of what has a direction, in torch."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from gavatar_runtime import native_library as nl
from gavatar_runtime.values.surface import Surface

from ..body.torch_rotations import quaternion_from_matrix, quaternion_product


def dense_weights(joint_index: np.ndarray, joint_weight: np.ndarray, num_joints: int) -> np.ndarray:
    """(N, J) matrix of the sparse weights (N, K). A dense product with the joints' transforms is one matrix multiply
    forward and backward, which without the kernel beats gathering per point (and scattering per joint backward)."""
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


def skin_sparse(points: Tensor, joint_index: Tensor, joint_weight: Tensor, transforms: Tensor) -> Tensor:
    """`skin` by the compiled kernel: sparse weights, forward and backward; `can_skin_sparse` says for which tensors.

    points: (B or 1, N, 3). joint_index: (N, K) int32. joint_weight: (N, K) float32. transforms: (B, J, 3, 4).
    Returns (B, N, 3). The same to the last bit whatever the number of threads.
    """
    return _SparseSkin.apply(points, joint_index, joint_weight, transforms)


def can_skin_sparse(points: Tensor) -> bool:
    """Whether `skin_sparse` takes points of this kind: float32 on the CPU, where the kernel was compiled."""
    return points.device.type == "cpu" and points.dtype == torch.float32 and nl.available()[0]


class _SparseSkin(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, joint_index: Tensor, joint_weight: Tensor, transforms: Tensor) -> Tensor:
        points, transforms = points.contiguous(), transforms.contiguous()
        (count, slots), (poses, joints) = joint_index.shape, transforms.shape[:2]
        out = points.new_empty(poses, count, 3)
        for b in range(poses):
            arrays = (points[min(b, len(points) - 1)], joint_index, joint_weight, transforms[b], out[b])
            _check(nl.library().gv_skin(count, slots, joints, 12, *(x.data_ptr() for x in arrays)))
        ctx.save_for_backward(points, joint_index, joint_weight, transforms)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        points, joint_index, joint_weight, transforms = ctx.saved_tensors
        grad = grad.contiguous()
        (count, slots), (poses, joints) = joint_index.shape, transforms.shape[:2]
        to_points = torch.empty_like(grad) if ctx.needs_input_grad[0] else None
        to_transforms = torch.empty_like(transforms) if ctx.needs_input_grad[3] else None
        for b in range(poses):
            arrays = (points[min(b, len(points) - 1)], joint_index, joint_weight, transforms[b], grad[b])
            wanted = (None if x is None else x[b].data_ptr() for x in (to_points, to_transforms))
            pointers = (*(x.data_ptr() for x in arrays), *wanted)
            _check(nl.library().gv_skin_backward(count, slots, joints, 12, *pointers))
        if to_points is not None and len(points) < poses:
            to_points = to_points.sum(0, keepdim=True)
        return to_points, None, None, to_transforms


def _check(code: int) -> None:
    if code == -2:
        raise IndexError("skin_sparse: joint_index has entries that transforms do not")
    nl.check(code)


def skinning_weights(surface: Surface, num_joints: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """(N, J) dense weights of a sampled surface."""
    return torch.as_tensor(dense_weights(surface.joint_index, surface.joint_weight, num_joints), dtype=dtype)
