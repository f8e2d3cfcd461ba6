"""The body reduced to what a fit needs: 22 joints, the 33 landmarks and an even sample of the surface."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from ..body.skeleton import SMPL_BODY_JOINTS, BodyData, joint_transforms
from ..body.torch_rotations import matrix_from_axis_angle
from .landmarks import fold_hands, landmark_rows


@dataclasses.dataclass(frozen=True)
class Posed:
    """T posed bodies in the world, metres. rotations: (T, 22, 3, 3) local. joints: (T, 22, 3). landmarks: (T, 33, 3).
    surface: (T, P, 3) or None where it was not asked for."""

    rotations: Tensor
    joints: Tensor
    landmarks: Tensor
    surface: Tensor | None


def spread_vertices(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of `count` points far from each other (farthest-point sampling from the first point)."""
    count = min(count, len(points))
    chosen = np.zeros(count, np.int64)
    distance = np.full(len(points), np.inf)
    for k in range(1, count):
        distance = np.minimum(distance, ((points - points[chosen[k - 1]]) ** 2).sum(-1))
        chosen[k] = distance.argmax()
    return chosen


class FitRig:
    """Poses landmarks and surface points of a body as functions of betas, rotations and translation."""

    def __init__(self, data: BodyData, surface_points: int = 1500, num_betas: int = 10):
        """num_betas: shape coefficients used, if the body has so many. Neither expression nor pose blendshapes."""
        shapedirs = data.shapedirs[:, :, :num_betas]
        self.num_betas = shapedirs.shape[2]
        self.parents = [int(p) for p in data.parents[:SMPL_BODY_JOINTS]]
        regressor, weights = landmark_rows(data)
        chosen = spread_vertices(data.v_template, surface_points)
        rows = [
            (data.J_regressor[:SMPL_BODY_JOINTS] @ data.v_template, data.J_regressor[:SMPL_BODY_JOINTS]),
            (regressor @ data.v_template, regressor),
        ]
        dirs = [np.einsum("pv,vcb->pcb", r, shapedirs) for _, r in rows]
        self.joints0, self.landmarks0 = (_tensor(base) for base, _ in rows)
        self.joint_dirs, self.landmark_dirs = (_tensor(d) for d in dirs)
        self.surface0, self.surface_dirs = _tensor(data.v_template[chosen]), _tensor(shapedirs[chosen])
        self.landmark_weights = _tensor(fold_hands(weights, data.parents))
        self.surface_weights = _tensor(fold_hands(data.lbs_weights[chosen], data.parents))
        top, bottom = data.v_template[:, 1].argmax(), data.v_template[:, 1].argmin()
        self.stature0 = float(data.v_template[top, 1] - data.v_template[bottom, 1])
        self.stature_dirs = _tensor(shapedirs[top, 1] - shapedirs[bottom, 1])

    def stature(self, betas: Tensor) -> Tensor:
        """() the rest body's height, metres."""
        return self.stature0 + self.stature_dirs @ betas

    def __call__(
        self, betas: Tensor, root: Tensor, poses: Tensor, trans: Tensor, offsets: Tensor, surface: bool
    ) -> Posed:
        """betas: (B,). root: (T, 3, 3) global orientation. poses: (T, 21, 3) axis-angle of the other body joints.
        trans: (T, 3) metres. offsets: (33, 3) metres, added to the landmarks in the rest pose."""
        rotations = torch.cat([root[:, None], matrix_from_axis_angle(poses)], 1)
        joints = self.joints0 + self.joint_dirs @ betas
        R, p = joint_transforms(rotations, joints, self.parents)
        transforms = torch.cat([R, (p - (R @ joints[..., None])[..., 0])[..., None]], -1)
        marks = self.landmarks0 + self.landmark_dirs @ betas + offsets
        shift = trans[:, None]
        skin_points = None
        if surface:
            skin_points = _skin(self.surface0 + self.surface_dirs @ betas, self.surface_weights, transforms) + shift
        return Posed(rotations, p + shift, _skin(marks, self.landmark_weights, transforms) + shift, skin_points)


def _skin(points: Tensor, weights: Tensor, transforms: Tensor) -> Tensor:
    """`gavatar.avatar.torch_skinning.skin` for points that all T frames share: (P, 3), (P, J), (T, J, 3, 4) -> (T, P,
    3).

    sum_j w_j A_j [x, 1] as one product of (P, 4 J) and (4 J, 3 T), which spares a blended matrix per point and frame.
    """
    homogeneous = torch.cat([points, torch.ones_like(points[:, :1])], -1)
    features = (weights[:, :, None] * homogeneous[:, None]).flatten(1)
    return torch.einsum("pf,tfc->tpc", features, transforms.transpose(-1, -2).flatten(1, 2))


def _tensor(array: np.ndarray) -> Tensor:
    return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32)
