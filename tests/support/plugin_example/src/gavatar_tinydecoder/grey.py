"""A tier of a third party: the whole body in one grey. This half is the player's and loads no torch."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.components import NoOptions
from gavatar_runtime.tiers import PLAYER_TIERS, Parts
from gavatar_runtime.tiers.members import ArrayMember, Rule

GREY = ArrayMember("grey.npz", {"shade": Rule((), low=0, high=1)})
SCALE = 0.01  # metres, of every Gaussian


@PLAYER_TIERS.register("grey", summary="the body in one grey")
class Grey:
    members = (GREY.file,)  # of the bundle, that it reads beside the surface
    moves = False  # the look does not depend on the pose, so it is decoded once
    networks = picks = False

    def __init__(self, options: NoOptions, *, parts: Parts):
        points = parts.take(parts.surface.points)
        colors = np.full_like(points, parts.arrays(GREY)["shade"])
        scales = parts.grow(np.full(len(points), SCALE, np.float32))
        self._attributes = points, colors, scales
        self.stage_seconds = {"encode": 0.0, "decode": 0.0}

    def __call__(self, pose: np.ndarray) -> tuple[np.ndarray, ...]:
        return self._attributes
