"""Difference of silhouettes."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs, check_choice
from gavatar.registry import LOSSES


@dataclasses.dataclass
class MaskConfig(LossConfig):
    """weight: not in the paper. norm: 'l1' tolerates wrong patches of a mask, 'l2' is gentler at its soft edge."""

    weight: float = 0.1
    norm: str = "l1"


@LOSSES.register("mask", config=MaskConfig, summary="mean difference of rendered alpha and footage mask")
class Mask:
    """Mean over pixels of |alpha - mask| (or its square): bounded, so a wrong mask cannot outweigh the picture, and
    with no logarithm to blow up where alpha is exactly 0 or 1."""

    def __init__(self, config: MaskConfig):
        check_choice("losses.mask.norm", config.norm, ("l1", "l2"))
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor:
        difference = inputs.alpha - inputs.mask
        return difference.abs().mean() if self.config.norm == "l1" else difference.square().mean()
