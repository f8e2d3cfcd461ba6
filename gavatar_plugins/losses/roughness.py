"""Penalty on differences between neighbours on the body: what pixels cannot tell apart is to look alike."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES, LossTraits


@dataclasses.dataclass
class RoughnessConfig(LossConfig):
    """weight: of differences of colour. offset: how much a centimetre of offset counts beside the range of a colour,
    scale: how much a spacing of scale does."""

    weight: float = 0.01
    offset: float = 0.0
    scale: float = 0.0


@LOSSES.register(
    "roughness",
    config=RoughnessConfig,
    summary="mean absolute difference of a point's colour to that of a neighbour on the body",
    traits=LossTraits(judges_poses=False),
)
class Roughness:
    """Total variation of the look over the body: absolute values keep edges, where squares would blur them. Where a
    pixel holds several points only their mean is seen, and without this each is anything; abstains where the look
    stands still."""

    def __init__(self, config: RoughnessConfig):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor | None:
        if inputs.to_neighbours is None:
            return None
        apart = inputs.to_neighbours.abs()
        total = apart[..., :3].mean()
        if self.config.offset:
            total = total + self.config.offset * apart[..., 3:6].mean()
        if self.config.scale:
            total = total + self.config.scale * apart[..., 6:].mean()
        return total
