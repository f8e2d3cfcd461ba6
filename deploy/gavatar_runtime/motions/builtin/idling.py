"""The built-in motion `idle`."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import WrongValue
from ...values.motion import Motion
from ..source import MOTIONS, MotionSource, MotionTraits
from .curves import cyclic
from .figure import SIDES, Figure, planted
from .standing import loop_phase


@dataclasses.dataclass
class IdleOptions:
    """seconds: one loop. fps: frames per second. breaths: in a loop, a whole number. shift: how far the weight goes
    from leg to leg, 1 as usual, 0 for somebody who stands still."""

    seconds: float = 8.0
    fps: float = 30.0
    breaths: int = 2
    shift: float = 1.0


@MOTIONS.register(
    "idle",
    config=IdleOptions,
    summary="stands, breathes, shifts the weight; loops",
    traits=MotionTraits(waits=True),
)
class Idle(MotionSource):
    """Somebody who waits: the feet stay, the weight goes from one leg to the other and back, the eyes wander, the chest
    rises and falls. The frame after the last would be the first."""

    def __init__(self, config: IdleOptions):
        if isinstance(config.breaths, bool) or not isinstance(config.breaths, int) or config.breaths < 0:
            raise WrongValue(f"`breaths={config.breaths}`: give a whole number, zero or more, so that it loops")
        if not (isinstance(config.shift, (int, float)) and 0 <= config.shift <= 2):
            raise WrongValue(f"`shift={config.shift}`: give a number from 0 to 2")
        self.config = config

    def load(self) -> Motion:
        phase = loop_phase("idle", self.config.seconds, self.config.fps)
        figure = Figure(len(phase))
        still = np.zeros_like(phase)
        breath = np.sin(2 * np.pi * self.config.breaths * phase)
        # from the left leg to the right and back, staying a while on either
        weight = self.config.shift * cyclic(phase, ((0.0, 0.0), (0.14, 1.0), (0.4, 0.85), (0.6, -0.9), (0.88, -1.0)))
        late = self.config.shift * cyclic(
            phase - 0.03, ((0.0, 0.0), (0.14, 1.0), (0.4, 0.85), (0.6, -0.9), (0.88, -1.0))
        )
        figure.tilt(x=1.0 + 0.3 * breath, y=2.0 * late, z=2.6 * weight)
        figure.place[:, 0] = 0.032 * weight
        figure.place[:, 2] = 0.004 * np.sin(2 * np.pi * phase)
        figure.bend_spine(x=-1.2 * breath, y=-1.5 * late, z=-3.4 * late)
        figure.turn_both("collar", z=1.6 * breath)
        figure.turn_both("shoulder", z=-1.2 * breath, x=0.5 * breath)
        figure.turn("left_shoulder", x=-1.5 * late, z=1.5 * late)
        figure.turn("right_shoulder", x=1.5 * late, z=1.5 * late)
        figure.turn_both("elbow", y=-4 - 1.5 * breath)
        look = cyclic(phase, ((0.05, 0.0), (0.2, 9.0), (0.38, 7.0), (0.5, -4.0), (0.72, -8.0), (0.9, 0.0)))
        figure.turn_head(x=1.0 - 0.5 * breath, y=look, z=1.2 * late)
        feet = tuple(
            planted(side, still - sign * 0.02, still, still, still + sign * 5)
            for side, sign in zip(SIDES, (1, -1), strict=True)
        )
        figure.settle(feet, np.ones((len(phase), 2), bool), whole=False)
        figure.stand(feet)
        return figure.motion("idle", self.config.fps)
