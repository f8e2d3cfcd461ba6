"""The built-in motion `turn`."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...values.motion import Motion
from ...values.skeletons import SMPLH
from ..source import MOTIONS, MotionSource
from .standing import loop_phase, motion_of, relaxed_pose


@dataclasses.dataclass
class TurnOptions:
    """seconds: one full turn. fps: frames per second."""

    seconds: float = 6.0
    fps: float = 30.0


@MOTIONS.register("turn", config=TurnOptions, summary="a full turn about the vertical, arms hanging", default=True)
class Turn(MotionSource):
    """A full turn to the person's left in a relaxed pose; the frame after the last would be the first."""

    def __init__(self, config: TurnOptions):
        self.config = config

    def load(self) -> Motion:
        phase = loop_phase("turn", self.config.seconds, self.config.fps)
        poses = np.repeat(relaxed_pose()[None], len(phase), 0)
        poses[:, SMPLH.index("pelvis"), 1] = 2 * np.pi * phase
        return motion_of("turn", poses, np.zeros((len(phase), 3)), self.config.fps)
