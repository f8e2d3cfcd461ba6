"""Builds the tier `blendshape`: residuals of the pose distilled into linear bases by body part."""

from __future__ import annotations

import dataclasses

from gavatar.export.distillation import distil
from gavatar.protocols import TierBuilder, TierSource
from gavatar.registry import TIERS
from gavatar_runtime.tiers.members import BLENDSHAPE


@dataclasses.dataclass
class BlendshapeOptions:
    """rank: bases of a body part. uv: side of the atlas they are computed at. samples: poses they are distilled from,
    beside the capture's. wide: poses over the range of motion that their weights are learnt on too. width: of the
    network's two hidden layers. steps: of its training."""

    rank: int = 16
    uv: int = 160
    samples: int = 500
    wide: int = 400
    width: int = 128
    steps: int = 3000


@TIERS.register("blendshape", config=BlendshapeOptions, summary="pose residuals as linear bases by body part")
class BlendshapeBuilder(TierBuilder):
    """blendshape.npz, as `gavatar.export.distillation` makes it."""

    needs = ("baked",)

    def __init__(self, options: BlendshapeOptions):
        self.options = options

    def build(self, source: TierSource) -> dict[str, bytes]:
        return {BLENDSHAPE.file: BLENDSHAPE.pack(distil(source, **dataclasses.asdict(self.options)))}
