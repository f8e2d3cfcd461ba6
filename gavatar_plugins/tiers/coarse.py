"""Builds the tier `coarse`: residuals of the pose decoded on a coarse sampling of the surface."""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar.export.onnx_graphs import decoder_model
from gavatar.export.tier_source import TierSource, upsampling
from gavatar.registry import TIERS
from gavatar_runtime.bundle import pack_arrays


@dataclasses.dataclass
class CoarseOptions:
    """uv: side of the atlas that residuals are decoded at."""

    uv: int = 128


@TIERS.register("coarse", config=CoarseOptions, summary="pose residuals decoded on few points and upsampled")
class CoarseBuilder:
    """decoder_coarse.onnx on the coarse points, and coarse.npz to upsample by."""

    needs = ("baked",)

    def __init__(self, options: CoarseOptions):
        self.options = options

    def build(self, source: TierSource) -> dict[str, bytes]:
        coarse = source.run.built.surface(self.options.uv)
        index, weight = upsampling(coarse, source.surface)
        ratio = np.median(source.surface.spacing) / np.median(coarse.spacing)
        arrays = {
            "index": index.astype(np.uint16 if len(coarse) <= 1 << 16 else np.int32),
            "weight": weight.astype(np.float16),
            "base": source.mean(coarse),
            "ratio": np.float32(ratio),
        }
        model = source.finish(decoder_model(source.run.avatar, coarse))
        return {"decoder_coarse.onnx": model, "coarse.npz": pack_arrays(arrays)}
