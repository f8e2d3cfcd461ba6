"""Penalty on the learnable feature tensor."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES, LossTraits


@dataclasses.dataclass
class FeatureConfig(LossConfig):
    """weight: the paper's 1."""

    weight: float = 1.0


@LOSSES.register(
    "feature",
    config=FeatureConfig,
    summary="mean square of the learnable features (paper: 1, stage 1)",
    traits=LossTraits(judges_poses=False),
)
class Feature:
    """Mean over all elements of F^2; abstains where F is absent or frozen (stage 2)."""

    def __init__(self, config: FeatureConfig):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor | None:
        if inputs.features is None or not inputs.features.requires_grad:
            return None
        return inputs.features.square().mean()
