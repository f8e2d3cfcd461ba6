"""The half of the tier `grey` that belongs to the training library: it writes what the player reads."""

from __future__ import annotations

import numpy as np

from gavatar.protocols import TierBuilder, TierSource
from gavatar.registry import TIERS, NoOptions

from .grey import GREY


@TIERS.register("grey", summary="the body in one grey")
class GreyBuilder(TierBuilder):
    needs = ()

    def __init__(self, options: NoOptions):
        pass

    def build(self, source: TierSource) -> dict[str, bytes]:
        colors = source.mean(source.surface)[:, 3:6]
        return {GREY.file: GREY.pack({"shade": np.float32(colors.mean())})}
