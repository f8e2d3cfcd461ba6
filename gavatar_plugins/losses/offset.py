"""Penalty on the distance of Gaussians from the body's surface."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES


@dataclasses.dataclass
class OffsetConfig(LossConfig):
    """weight: the paper's 10 (the authors' code: decay 0.85, decay_every 0.1)."""

    weight: float = 10.0


@LOSSES.register("offset", config=OffsetConfig, summary="mean square of the offsets from the surface (paper: 10)")
class Offset:
    """Mean over points and axes of the squared offset, square metres."""

    def __init__(self, config: OffsetConfig):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor | None:
        return None if inputs.offsets is None else inputs.offsets.square().mean()
