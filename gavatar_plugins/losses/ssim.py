"""Structural dissimilarity."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.images.image_quality import ssim
from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES, LossTraits


@dataclasses.dataclass
class SsimConfig(LossConfig):
    """weight: the paper's 0.2."""

    weight: float = 0.2


@LOSSES.register(
    "ssim",
    config=SsimConfig,
    summary="1 - SSIM, Gaussian window of 11 pixels (paper: 0.2)",
    traits=LossTraits(in_progress_bar=True),
)
class Ssim:
    """1 - SSIM, mean over batch, channels and window positions; see `gavatar.images.image_quality.ssim`."""

    def __init__(self, config: SsimConfig):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor:
        return 1 - ssim(inputs.render, inputs.target).mean()
