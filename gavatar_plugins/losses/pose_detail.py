"""Penalty on fine detail that depends on the pose: light and folds are coarse on the body, texture stays still."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES, LossTraits


@dataclasses.dataclass
class PoseDetailConfig(LossConfig):
    """weight: 10 holds the root mean square near 0.01 of the range of colours."""

    weight: float = 10.0


@LOSSES.register(
    "pose_detail",
    config=PoseDetailConfig,
    summary="mean square of the colours' change with the pose, as far as it is finer than 5 cm on the body",
    traits=LossTraits(judges_poses=False),
)
class PoseDetail:
    """Mean over all elements of the squared fine part; abstains where there is no pose encoder."""

    def __init__(self, config: PoseDetailConfig):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor | None:
        return None if inputs.pose_detail is None else inputs.pose_detail.square().mean()
