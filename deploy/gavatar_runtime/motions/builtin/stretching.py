"""The built-in motion `stretch`."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import WrongValue
from ...values.motion import Motion
from ..source import MOTIONS, MotionSource
from .curves import cyclic
from .figure import SIDES, Figure, planted
from .standing import loop_phase


@dataclasses.dataclass
class StretchOptions:
    """seconds: one loop. fps: frames per second. reach: how far it goes, 1 down to the toes, 0 not at all."""

    seconds: float = 14.0
    fps: float = 30.0
    reach: float = 1.0


@MOTIONS.register(
    "stretch", config=StretchOptions, summary="arms overhead, to either side, down to the toes; loops",
)  # fmt: skip
class Stretch(MotionSource):
    """Both arms overhead, a bend to the left, one to the right, down to the toes, and up again joint by joint. The
    frame after the last would be the first."""

    def __init__(self, config: StretchOptions):
        if isinstance(config.reach, bool) or not (isinstance(config.reach, (int, float)) and 0 <= config.reach <= 1):
            raise WrongValue(f"`reach={config.reach}`: give a number from 0 to 1")
        self.config = config

    def load(self) -> Motion:
        phase = loop_phase("stretch", self.config.seconds, self.config.fps)
        reach = self.config.reach
        up = reach * cyclic(phase, ((0.02, 0), (0.13, 1), (0.55, 1), (0.66, 0)))
        side = reach * cyclic(phase, ((0.17, 0), (0.24, 1), (0.31, 1), (0.42, -1), (0.49, -1), (0.56, 0)))
        down = reach * cyclic(phase, ((0.55, 0), (0.69, 1), (0.8, 1), (0.95, 0)))
        late = reach * cyclic(phase, ((0.56, 0), (0.7, 1), (0.82, 1), (0.985, 0)))  # the neck unrolls last
        figure, still = Figure(len(phase)), np.zeros_like(phase)
        figure.tilt(x=72 * down - 2 * up, z=-5 * side)
        figure.place[:, 0] = -0.05 * side
        figure.place[:, 2] = -0.13 * down
        figure.bend_spine(x=60 * (0.6 * down + 0.4 * late) - 8 * up, z=-30 * side, shares=(0.36, 0.36, 0.28))
        figure.turn_head(x=28 * late - 12 * up * (1 - down), z=-8 * side)
        for name, sign in (("left", 1), ("right", -1)):
            figure.turn(f"{name}_shoulder", z=sign * 118 * up, y=-sign * 12 * up)
            figure.turn(f"{name}_shoulder", x=-112 * down)
            figure.turn(f"{name}_collar", z=sign * 22 * up, y=-sign * 10 * down)
            figure.turn(f"{name}_elbow", y=sign * (12 * down + 4 * up), z=sign * 8 * up)
        feet = tuple(
            planted(side_name, still + sign * 0.01, still, still, still + sign * 4)
            for side_name, sign in zip(SIDES, (1, -1), strict=True)
        )
        figure.settle(feet, np.ones((len(phase), 2), bool), whole=False)
        figure.stand(feet)
        return figure.motion("stretch", self.config.fps)
