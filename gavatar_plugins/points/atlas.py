"""One point a texel of the body's UV atlas, as published."""

from __future__ import annotations

import math

import numpy as np

from gavatar.avatar.atlas import MAX_RESOLUTION, MIN_RESOLUTION, sample_atlas
from gavatar.protocols import PointPolicy
from gavatar.registry import POINTS, NoOptions, PointTraits
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Surface


@POINTS.register("atlas", summary="the texels of the UV atlas (paper)", traits=PointTraits(texels=True, former=True))
class AtlasPoints(PointPolicy):
    """The texels of the smallest atlas that has as many, the first of them in progressive order: the number of texels
    of an atlas gives that atlas. Texels are far apart where the atlas is coarse, and farther in one direction."""

    def __init__(self, options: NoOptions):
        self.options = options

    def sample(self, body: BodyData, betas: np.ndarray | None, count: int) -> Surface:
        low, high = MIN_RESOLUTION, MAX_RESOLUTION  # the smallest side that will do lies between, if any does
        side = MIN_RESOLUTION
        while low < high:
            atlas = sample_atlas(body, betas, side)
            low, high = (low, side) if len(atlas) >= count else (side + 1, high)
            guess = math.ceil(side * math.sqrt(count / len(atlas)))  # texels grow as the square of the side, nearly
            side = min(max(guess, low), high - 1) if low < high else low
        atlas = sample_atlas(body, betas, low)
        if len(atlas) < count:
            raise UserError(f"the atlas of body '{body.name}' has {len(atlas):,} texels at most, not {count:,}")
        return atlas.prefix(count)
