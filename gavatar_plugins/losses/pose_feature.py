"""Penalty on the features that depend on the pose."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES, LossTraits


@dataclasses.dataclass
class PoseFeatureConfig(LossConfig):
    """weight: the paper's 1 (the authors' code uses 10)."""

    weight: float = 1.0


@LOSSES.register(
    "pose_feature",
    config=PoseFeatureConfig,
    summary="mean square of the pose features (paper: 1)",
    traits=LossTraits(judges_poses=False),
)
class PoseFeature:
    """Mean over all elements of the squared pose features; abstains where there is no pose encoder (stage 1)."""

    def __init__(self, config: PoseFeatureConfig):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor | None:
        return None if inputs.pose_features is None else inputs.pose_features.square().mean()
