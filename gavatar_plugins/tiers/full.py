"""The tier `full`: its members are those without which no bundle is written."""

from __future__ import annotations

from gavatar.protocols import TierBuilder, TierSource
from gavatar.registry import TIERS, NoOptions


@TIERS.register("full", summary="the networks as trained, float32", default=True)
class FullBuilder(TierBuilder):
    """Nothing beyond the bundle's own members."""

    needs = ()

    def __init__(self, options: NoOptions):
        pass

    def build(self, source: TierSource) -> dict[str, bytes]:
        return {}
