"""Builds the tier `coarse`: residuals of the pose decoded on a coarse sampling of the surface."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gavatar.export.onnx_graphs import decoder_model
from gavatar.export.tier_source import upsampling
from gavatar.protocols import TierBuilder, TierSource
from gavatar.registry import TIERS
from gavatar_runtime.tiers.members import COARSE, DECODER_COARSE


@dataclasses.dataclass
class CoarseOptions:
    """uv: side of the atlas that residuals are decoded at."""

    uv: int = 128


@TIERS.register("coarse", config=CoarseOptions, summary="pose residuals decoded on few points and upsampled")
class CoarseBuilder(TierBuilder):
    """decoder_coarse.onnx on the coarse points, and coarse.npz to upsample by."""

    needs = ("baked",)

    def __init__(self, options: CoarseOptions):
        self.options = options

    def build(self, source: TierSource) -> dict[str, bytes]:
        coarse = source.surface_at(self.options.uv)
        index, weight = upsampling(coarse, source.surface)
        ratio = np.median(source.surface.spacing) / np.median(coarse.spacing)
        arrays: dict[str, Any] = {
            "index": index.astype(np.uint16 if len(coarse) <= 1 << 16 else np.int32),
            "weight": weight.astype(np.float16),
            "base": source.mean(coarse),
            "ratio": np.float32(ratio),
        }
        model = source.finish(decoder_model(source.avatar, coarse))
        return {DECODER_COARSE: model, COARSE.file: COARSE.pack(arrays)}
