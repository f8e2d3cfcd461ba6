"""Penalty on the size of Gaussians."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs, check_choice
from gavatar.registry import LOSSES


@dataclasses.dataclass
class ScaleConfig(LossConfig):
    """weight: the paper's 1. norm: 'l2' is the paper's; the authors' code uses 'l1' with weight 0.03."""

    weight: float = 1.0
    norm: str = "l2"


@LOSSES.register("scale", config=ScaleConfig, summary="mean square of the Gaussians' scales (paper: 1)")
class Scale:
    """Mean over points of the squared scale, square metres (norm 'l1': of the scale, metres)."""

    def __init__(self, config: ScaleConfig):
        check_choice("losses.scale.norm", config.norm, ("l1", "l2"))
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor | None:
        if inputs.scales is None:
            return None
        return inputs.scales.abs().mean() if self.config.norm == "l1" else inputs.scales.square().mean()
