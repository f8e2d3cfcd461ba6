"""The tier `baked`: the mean over the capture's poses, no network at all."""

from __future__ import annotations

import numpy as np

from ..components import NoOptions
from ..decoding.residuals import Attributes
from . import PLAYER_TIERS, Parts, TierTraits
from .members import BAKED


def baked_attributes(parts: Parts) -> Attributes:
    """Points (N, 3), colors (N, 3), scales (N,) of baked.npz, float32."""
    arrays = parts.arrays(BAKED)
    offsets, colors, scales = (arrays[name] for name in BAKED.arrays)
    points, colors, scales = map(parts.take, (parts.surface.points + offsets, colors, scales))
    return points, colors, parts.grow(scales)


@PLAYER_TIERS.register("baked", summary="one look for all poses, no network", traits=TierTraits(linear=True))
class Baked:
    """Decoded once; only skinning is left to each frame."""

    members: tuple[str, ...] = (BAKED.file,)
    moves, networks, picks = False, False, False

    def __init__(self, options: NoOptions, *, parts: Parts):
        self._attributes = baked_attributes(parts)
        self.stage_seconds: dict[str, float] = {"encode": 0.0, "decode": 0.0}

    def __call__(self, pose: np.ndarray) -> Attributes:
        return self._attributes

    def linear(self) -> tuple[Attributes, None]:
        """See `LinearTier`."""
        return self._attributes, None
