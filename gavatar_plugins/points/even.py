"""Points evenly apart all over the body."""

from __future__ import annotations

import numpy as np

from gavatar.avatar.points import sample_points
from gavatar.protocols import PointPolicy
from gavatar.registry import POINTS, NoOptions
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Surface


@POINTS.register("even", summary="as many points a square centimetre everywhere")
class EvenPoints(PointPolicy):
    """The same density on all of the body."""

    def __init__(self, options: NoOptions):
        self.options = options

    def sample(self, body: BodyData, betas: np.ndarray | None, count: int) -> Surface:
        return sample_points(body, betas, count)
