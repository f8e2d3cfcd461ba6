"""The built-in motion `wave`."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import WrongValue
from ...values.motion import Motion
from ...values.skeletons import FINGERS, SMPLH
from ..source import MOTIONS, MotionSource, MotionTraits
from .standing import composed, loop_phase, motion_of, relaxed_pose


@dataclasses.dataclass
class WaveOptions:
    """seconds: one loop. fps: frames per second. waves: swings of the forearm in a loop, a whole number."""

    seconds: float = 3.0
    fps: float = 30.0
    waves: int = 5


@MOTIONS.register(
    "wave",
    config=WaveOptions,
    summary="the right hand waves, the body sways a little; loops",
    traits=MotionTraits(varied=True),
)
class Wave(MotionSource):
    """The right forearm stands up and swings about the elbow, the hand trailing behind; the weight shifts from foot to
    foot once a loop. The frame after the last would be the first."""

    def __init__(self, config: WaveOptions):
        if not isinstance(config.waves, int) or config.waves < 0:
            raise WrongValue(f"`waves={config.waves}`: give a whole number, zero or more, so that it loops")
        self.config = config

    def load(self) -> Motion:
        phase = loop_phase("wave", self.config.seconds, self.config.fps)
        swing = 2 * np.pi * self.config.waves * phase
        sway = np.sin(2 * np.pi * phase)
        poses = np.repeat(relaxed_pose()[None], len(phase), 0)
        trans = np.zeros((len(phase), 3))
        _lift_right_arm(poses, swing)
        _sway(poses, trans, sway, np.sin(2 * np.pi * phase - 0.6))
        return motion_of("wave", poses, trans, self.config.fps)


def _lift_right_arm(poses: np.ndarray, swing: np.ndarray) -> None:
    """Write the raised, waving right arm into poses (T, 52, 3); swing (T,) is the wave's phase, radians."""
    collar, shoulder, elbow, wrist = (SMPLH.index(f"right_{n}") for n in ("collar", "shoulder", "elbow", "wrist"))
    side = np.sin(swing)
    poses[:, collar] = np.radians((0, 0, -8))
    # the long axis turned until the forearm, which bends forward in the T-pose, bends upwards with the palm ahead;
    # then the upper arm brought to a little below the horizontal and a little forward
    lifted = np.stack([np.zeros_like(side), np.full_like(side, 22), 5 + 3 * side], -1)
    twist = np.stack([np.full_like(side, -78), np.zeros_like(side), np.zeros_like(side)], -1)
    poses[:, shoulder] = composed(lifted, twist)
    poses[:, elbow] = np.radians(np.stack([0 * side, 88 + 22 * side, 0 * side], -1))
    trailing = np.sin(swing - 0.7)
    poses[:, wrist] = np.radians(np.stack([0 * side, 10 * trailing, 0 * side], -1))
    for name in FINGERS:
        if name.startswith("right"):
            poses[:, SMPLH.index(name), 2] *= 0.3  # an open hand


def _sway(poses: np.ndarray, trans: np.ndarray, lean: np.ndarray, late: np.ndarray) -> None:
    """Shift the weight: hips glide sideways by a centimetre over feet that stay, the chest leans against them."""

    def turn(name: str, axis: int, degrees: np.ndarray) -> None:
        poses[:, SMPLH.index(name), axis] += np.radians(degrees)

    glide = 0.012 * lean
    trans[:, 0] += glide
    leg = 0.9  # metres from hip to ankle of any adult, near enough for a centimetre's glide
    for side in ("left", "right"):
        angle = np.degrees(np.arctan2(glide, leg))
        turn(f"{side}_hip", 2, -angle)
        turn(f"{side}_ankle", 2, angle)
    turn("spine1", 2, 0.8 * lean)
    turn("spine3", 2, 0.8 * late)
    turn("spine2", 1, 2.0 * late)
    turn("neck", 2, 2.0 + 1.5 * late)
    turn("head", 2, 2.5 + 1.5 * late)
    turn("left_shoulder", 2, 1.5 * late)
    turn("left_elbow", 1, 1.5 * late)
