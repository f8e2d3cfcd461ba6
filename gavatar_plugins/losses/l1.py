"""Mean absolute difference of colours."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES, LossTraits


@dataclasses.dataclass
class L1Config(LossConfig):
    """weight: the paper's 0.8."""

    weight: float = 0.8


@LOSSES.register(
    "l1",
    config=L1Config,
    summary="mean absolute colour difference (paper: 0.8)",
    traits=LossTraits(in_progress_bar=True),
)
class L1:
    """Mean over all pixels and channels of |render - target|; the gradient at equality is zero."""

    def __init__(self, config: L1Config):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor:
        return (inputs.render - inputs.target).abs().mean()
