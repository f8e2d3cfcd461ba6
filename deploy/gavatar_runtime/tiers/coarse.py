"""The tier `coarse`: residuals of the pose decoded on a coarse sampling of the surface and upsampled onto `baked`."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from ..components import NoOptions
from ..decoding.residuals import Attributes, empty, packed, upsample
from . import PLAYER_TIERS, Parts
from .baked import baked_attributes
from .full import Encoder, decoder_network
from .members import BAKED, COARSE, DECODER_COARSE, ENCODER, POSE_FEATURES


@PLAYER_TIERS.register("coarse", summary="pose residuals decoded on few points and upsampled")
class Coarse:
    """The coarse points' residuals against their mean, weighted onto each Gaussian's still look; see
    `members.COARSE`."""

    members: tuple[str, ...] = (ENCODER, DECODER_COARSE, COARSE.file, BAKED.file)
    moves, networks, picks = True, True, False

    def __init__(self, options: NoOptions, *, parts: Parts):
        arrays = parts.arrays(COARSE)
        self._parts = parts
        self._encoder = Encoder(parts, ENCODER)
        self._decoder = decoder_network(parts, DECODER_COARSE, (POSE_FEATURES,), by_rows=True)
        self._static = packed(*baked_attributes(parts))
        self._index = np.ascontiguousarray(parts.take(arrays["index"]))
        self._weight = np.ascontiguousarray(parts.take(arrays["weight"]), np.float32)
        self._base = arrays["base"].astype(np.float32)
        self._ratio = float(arrays["ratio"])
        self._rows = np.arange(len(self._base), dtype=np.int32) if self._decoder.picks else None
        self._decoded: list[np.ndarray] | None = None
        self._table = np.zeros((len(self._base), 8), np.float32)
        self._out = [empty(len(parts)) for _ in range(3)]
        self._calls = 0
        self.stage_seconds: dict[str, float] = {}

    def __call__(self, pose: np.ndarray) -> Attributes:
        start = perf_counter()
        features = self._encoder(pose)
        encoded = perf_counter()
        if self._decoded is None:
            offsets, colors, scales = self._decoder(features, rows=self._rows)
            self._decoded = list(self._parts.check((offsets, colors, scales), DECODER_COARSE, len(self._base)))
        else:
            self._decoder(features, rows=self._rows, out=self._decoded)
        self._table[:, :3], self._table[:, 3:6], self._table[:, 6] = self._decoded
        self._table[:, :7] -= self._base
        self._table[:, 6] *= self._ratio  # coarse points stand further apart than fine ones
        self._calls += 1
        out = upsample(self._static, self._index, self._weight, self._table, self._out[self._calls % 3])
        self.stage_seconds = {"encode": encoded - start, "decode": perf_counter() - encoded}
        return out
