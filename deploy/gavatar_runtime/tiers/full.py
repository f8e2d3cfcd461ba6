"""The tier `full`: the networks as they were trained, in float32; and `int8`, the same networks in 8-bit arithmetic."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from ..network import Network
from ..registry import NoOptions
from ..surface import positional_map
from . import PLAYER_TIERS, Parts

OUTPUTS = ("offsets", "colors", "scales")


class Encoder:
    """The pose features (1, C, M, M) of a pose."""

    def __init__(self, parts: Parts, member: str):
        self._network = Network(parts.bundle, member, ("positional_map",), ("pose_features",), parts.threads)
        self._surface = parts.map_surface

    def __call__(self, pose: np.ndarray) -> np.ndarray:
        image = positional_map(self._surface, pose)
        return self._network(np.ascontiguousarray(image.transpose(2, 0, 1)[None]))[0]


@PLAYER_TIERS.register("full", summary="the networks as trained, float32")
class Full:
    """Encoder, then decoder on every Gaussian."""

    encoder, decoder = members = "encoder.onnx", "decoder.onnx"

    def __init__(self, options: NoOptions, *, parts: Parts):
        self._parts = parts
        self.moves = parts.bundle.manifest.dynamic
        self.stage_seconds: dict[str, float] = {}
        self._encoder = Encoder(parts, self.encoder) if self.moves else None
        inputs = ("pose_features",) if self.moves else ()
        self._decoder = Network(parts.bundle, self.decoder, inputs, OUTPUTS, parts.threads)

    def __call__(self, pose: np.ndarray):
        start = perf_counter()
        features = () if self._encoder is None else (self._encoder(pose),)
        encoded = perf_counter()
        offsets, colors, scales = self._parts.check(tuple(self._decoder(*features)), self.decoder)
        points = self._parts.surface.points + offsets
        if self._parts.chosen is not None:
            points, colors, scales = map(self._parts.take, (points, colors, scales))
            scales = self._parts.grow(scales)
        self.stage_seconds = {"encode": encoded - start, "decode": perf_counter() - encoded}
        return points, colors, scales


@PLAYER_TIERS.register("int8", summary="the networks in 8-bit arithmetic, calibrated on the capture's poses")
class Int8(Full):
    """As `full`, by the quantised members."""

    encoder, decoder = members = "encoder_int8.onnx", "decoder_int8.onnx"
