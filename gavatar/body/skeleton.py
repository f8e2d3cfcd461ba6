"""Kinematics of bodies in torch.

The numbers live in `gavatar_runtime.values.body.BodyData`; NumPy kinematics in `gavatar_runtime.geometry.kinematics`
are the tested reference of the functions here.
"""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.values.body import SMPL_BODY_JOINTS, BodyData

from .torch_rotations import matrix_from_axis_angle

__all__ = ["SMPL_BODY_JOINTS", "BodyData", "PosedBody", "Skeleton", "joint_transforms"]


def joint_transforms(rotations: Tensor, joints: Tensor, parents: list[int]) -> tuple[Tensor, Tensor]:
    """World rotation and position of every joint.

    rotations: (..., J, 3, 3) local. joints: (J, 3) or (..., J, 3) rest positions, metres. parents: -1 for the root.
    Returns (..., J, 3, 3) and (..., J, 3), without the global translation (SMPL, Loper et al. 2015, equation 3).

    By pointer doubling: a round joins to each joint's transform that of the ancestor where it ends, so that chains of
    ten joints take four batched products instead of ten times dozens of small ones, which cost a step more than their
    arithmetic. `gavatar_runtime.geometry.kinematics.joint_transforms` goes joint by joint and is the reference.
    """
    parent, rounds = _ancestors(tuple(parents), joints.device)
    padded = torch.cat([joints, torch.zeros_like(joints[..., :1, :])], -2)  # where the roots' parent stands
    bones = (joints - padded.index_select(-2, parent)).expand(*rotations.shape[:-2], 3)
    row = torch.tensor([0.0, 0, 0, 1], dtype=rotations.dtype, device=rotations.device).expand(*bones.shape[:-1], 1, 4)
    T = torch.cat([torch.cat([rotations, bones[..., None]], -1), row], -2)
    identity = torch.eye(4, dtype=T.dtype, device=T.device).expand(*T.shape[:-3], 1, 4, 4)
    for ancestor in rounds:
        T = torch.cat([T, identity], -3).index_select(-3, ancestor) @ T
    return T[..., :3, :3], T[..., :3, 3]


@functools.lru_cache(maxsize=16)
def _ancestors(parents: tuple[int, ...], device: torch.device) -> tuple[Tensor, list[Tensor]]:
    """(J,) each joint's parent, and by round the ancestor 1, 2, 4... generations up; J where there is none."""
    none = len(parents)
    ancestor = np.array([p if p >= 0 else none for p in parents] + [none])
    # cached beyond the caller's mode: tensors made under inference_mode could never be trained through
    with torch.inference_mode(False):
        parent, rounds = torch.as_tensor(ancestor[:-1], device=device), []
        while (ancestor != none).any():
            rounds.append(torch.as_tensor(ancestor[:-1], device=device))
            ancestor = ancestor[ancestor]
    return parent, rounds


class PosedBody(torch.nn.Module):
    """The whole body as a differentiable function of shape, expression, pose and translation.

    `BodyData.posed` is its NumPy reference; both are held against the `smplx` package.
    """

    v_template: Tensor
    shapedirs: Tensor
    exprdirs: Tensor
    posedirs: Tensor
    J_regressor: Tensor
    weights: Tensor

    def __init__(self, data: BodyData, dtype: torch.dtype = torch.float32):
        super().__init__()
        self.parents = [int(p) for p in data.parents]
        V = len(data.v_template)
        pose = np.zeros((V, 3, 0)) if data.posedirs is None else data.posedirs
        expression = np.zeros((V, 3, 0)) if data.exprdirs is None else data.exprdirs
        arrays = {
            "v_template": data.v_template, "shapedirs": data.shapedirs, "exprdirs": expression, "posedirs": pose,
            "J_regressor": data.J_regressor, "weights": data.lbs_weights,
        }  # fmt: skip
        for name, array in arrays.items():
            self.register_buffer(name, torch.as_tensor(array, dtype=dtype), persistent=False)

    def forward(
        self, poses: Tensor, betas: Tensor | None = None, trans: Tensor | None = None, expression: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """(B, V, 3) vertices and (B, J, 3) joints, metres (SMPL, Loper et al. 2015, equations 2 to 10).

        poses: (B, J, 3) axis-angle of every joint. betas: (B or 1, n), expression: (B or 1, e), the first n and e
        coefficients. trans: (B or 1, 3) metres.
        """
        vertices = self.v_template
        for coefficients, directions in ((betas, self.shapedirs), (expression, self.exprdirs)):
            if coefficients is not None:
                used = directions[:, :, : coefficients.shape[-1]]
                vertices = vertices + torch.einsum("bn,vcn->bvc", coefficients[:, : used.shape[2]], used)
        joints = self.J_regressor @ vertices
        rotations = matrix_from_axis_angle(poses)
        if self.posedirs.shape[2]:
            feature = rotations[:, 1:] - torch.eye(3, dtype=poses.dtype, device=poses.device)
            vertices = vertices + torch.einsum("bp,vcp->bvc", feature.flatten(1), self.posedirs)
        R, p = joint_transforms(rotations, joints, self.parents)
        transforms = torch.cat([R, (p - (R @ joints[..., None])[..., 0])[..., None]], -1)
        blended = (self.weights @ transforms.flatten(-2)).unflatten(-1, (3, 4))
        posed = (blended[..., :3] @ vertices.expand(len(poses), -1, -1)[..., None])[..., 0] + blended[..., 3]
        shift = 0 if trans is None else trans[:, None]
        return posed + shift, p + shift


class Skeleton(torch.nn.Module):
    """The differentiable skeleton of one person: rest joints of a shape, parents, canonical pose.

    data: the body. betas: (B,) shape coefficients or None. data is kept for what a surface needs of it.
    """

    joints: Tensor
    _canonical: Tensor
    _canonical_rot_inv: Tensor
    _canonical_trans: Tensor

    def __init__(self, data: BodyData, betas: np.ndarray | None = None, dtype: torch.dtype = torch.float32):
        super().__init__()
        self.data = data
        self.parents = [int(p) for p in data.parents]
        _, joints = data.shaped(betas)
        canonical = matrix_from_axis_angle(torch.as_tensor(data.canonical_pose(), dtype=dtype))
        self.register_buffer("joints", torch.as_tensor(joints, dtype=dtype), persistent=False)
        self.register_buffer("_canonical", canonical, persistent=False)
        A_rot, A_trans = self.skinning(canonical)
        self.register_buffer("_canonical_rot_inv", A_rot.transpose(-1, -2).contiguous(), persistent=False)
        self.register_buffer("_canonical_trans", A_trans, persistent=False)

    def posed_joints(self, rotations: Tensor) -> Tensor:
        """(..., J, 3, 3) local rotations -> (..., J, 3) joint positions, metres, without translation."""
        return joint_transforms(rotations, self.joints, self.parents)[1]

    def skinning(self, rotations: Tensor, shift: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Rest-to-posed skinning transforms: (..., J, 3, 3) linear part and (..., J, 3) offset. shift: (..., J, 3)
        metres that the rest joints are moved by, or None."""
        joints = self.joints if shift is None else self.joints + shift
        R, p = joint_transforms(rotations, joints, self.parents)
        return R, p - (R @ joints[..., None])[..., 0]

    def canonical_to_posed(self, rotations: Tensor, shift: Tensor | None = None) -> Tensor:
        """(..., J, 3, 4) transforms from the canonical pose to the pose: A_live A_canonical^-1, inverted rigidly.
        shift: as in `skinning`, an expression's."""
        R, t = self.skinning(rotations, shift)
        linear = R @ self._canonical_rot_inv
        start = self._canonical_trans
        if shift is not None:
            start = self.skinning(self._canonical.expand_as(rotations), shift)[1]
        offset = t - (linear @ start[..., None])[..., 0]
        return torch.cat([linear, offset[..., None]], -1)
