"""The built-in motion `dance`."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import WrongValue
from ...values.motion import Motion
from ..source import MOTIONS, MotionSource, MotionTraits
from .curves import cyclic
from .figure import SIDES, Figure, stepping_aside
from .standing import loop_phase

BEATS = 8  # of two bars: what is repeated
STEP = 0.3  # metres


@dataclasses.dataclass
class DanceOptions:
    """bars: of a loop, of four beats each, an even number. bpm: beats a minute. fps: frames per second. size: how far
    hips and arms go, 1 as usual."""

    bars: int = 2
    bpm: float = 112.0
    fps: float = 30.0
    size: float = 1.0


@MOTIONS.register(
    "dance", config=DanceOptions, summary="steps from side to side, hips and arms on the beat; loops",
    traits=MotionTraits(whole=True),
)  # fmt: skip
class Dance(MotionSource):
    """Step, touch, step, touch: a bar with swinging arms, a bar with both arms up. The frame after the last would be
    the first."""

    def __init__(self, config: DanceOptions):
        if isinstance(config.bars, bool) or not isinstance(config.bars, int) or config.bars < 2 or config.bars % 2:
            raise WrongValue(f"`bars={config.bars}`: give an even number, 2 or more, so that it loops")
        for name, low, high in (("bpm", 60, 160), ("size", 0, 1.5)):
            value = getattr(config, name)
            if isinstance(value, bool) or not (isinstance(value, (int, float)) and low <= value <= high):
                raise WrongValue(f"`{name}={value}`: give a number from {low:g} to {high:g}")
        self.config = config

    def load(self) -> Motion:
        c = self.config
        beat = 4 * c.bars * loop_phase("dance", 4 * c.bars * 60 / c.bpm, c.fps)
        figure = Figure(len(beat))
        _trunk(figure, beat, c.size)
        _arms(figure, beat, c.size)
        ways = {
            "left": ((1.0, 1.6, 0.08 - STEP, 0.05), (2.0, 2.65, 0.03, 0.0)),
            "right": ((0.0, 0.65, -0.03 - STEP, 0.0), (3.0, 3.6, -0.08, 0.05)),
        }
        feet = tuple(stepping_aside(side, beat, 4, ways[side]) for side in SIDES)
        bearing = np.stack([foot.pitch == 0 for foot in feet], -1)
        figure.settle(feet, bearing, straight=0.995, whole=False)
        figure.stand(feet)
        return figure.motion("dance", c.fps)


def _trunk(figure: Figure, beat: np.ndarray, size: float) -> None:
    down = np.cos(2 * np.pi * beat)  # 1 on the beat
    # over the foot that bears: to the right from beat 0 on, back to the left from beat 2 on
    over = cyclic(
        beat / 4,
        (
            (0.0, -0.02),
            (0.18, -0.86),
            (0.3, -1.06),
            (0.46, -0.98),
            (0.5, -0.94),
            (0.68, -0.14),
            (0.8, 0.1),
            (0.96, 0.02),
        ),
    )
    hips = size * cyclic(beat / 4, ((0.02, 0.3), (0.2, -0.6), (0.32, -1.0), (0.52, -0.3), (0.7, 0.6), (0.82, 1.0)))
    sway = size * np.sin(np.pi * (beat - 0.15))
    figure.tilt(x=4 + 2 * down, y=-9 * hips, z=6 * hips)
    figure.place[:, 0] = STEP * over + 0.012 * hips
    figure.place[:, 1] = -0.032 - 0.022 * down
    figure.bend_spine(x=3 + 2.5 * size * down, y=15 * hips, z=-8 * hips + 2 * sway)
    figure.turn_head(x=-5 - 4 * size * np.cos(2 * np.pi * (beat - 0.12)), y=-6 * hips, z=3 * sway)


def _arms(figure: Figure, beat: np.ndarray, size: float) -> None:
    bar = beat / BEATS
    up = cyclic(bar, ((0.0, 0.0), (0.44, 0.0), (0.56, 1.0), (0.92, 1.0)))  # the second bar's
    swing, sway = np.cos(np.pi * beat), np.sin(np.pi * (beat - 0.1))
    punch = np.cos(2 * np.pi * (beat - 0.1))
    for side, sign in (("left", 1), ("right", -1)):
        low = (1 - up) * size
        figure.turn(f"{side}_shoulder", y=-sign * 14 * low, z=sign * 10 * low)
        figure.turn(f"{side}_shoulder", x=low * (-14 + sign * 30 * swing))
        figure.turn(f"{side}_shoulder", z=up * (sign * (114 + 6 * size * punch) + 14 * size * sway), y=-sign * 24 * up)
        figure.turn(f"{side}_collar", z=up * (sign * 16 + 3 * size * sway) + sign * low * 2 * punch)
        figure.turn(f"{side}_elbow", y=-sign * (low * (62 + 14 * punch) + up * (40 - 16 * size * punch)))
        figure.turn(f"{side}_wrist", z=up * 12 * size * np.sin(np.pi * (beat - 0.35)))
