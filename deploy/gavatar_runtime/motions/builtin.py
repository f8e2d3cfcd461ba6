"""Motions that need no file: enough to look at an avatar from all sides and to see it move.

Angles are relative to the T-pose of an SMPL-H skeleton that faces +z with its left arm along +x. Mirroring a joint's
rotation keeps its x and negates y and z.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..errors import UserError, WrongValue
from ..geometry.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle
from ..values.motion import Motion
from ..values.skeletons import FINGERS, SMPLH
from .source import MOTIONS, MotionSource, MotionTraits

# Degrees about x, y, z of left-hand joints; the right side mirrors them. A standing person's arms hang a palm's width
# off the hips, turned in by their own weight, elbows and fingers never quite straight.
RELAXED_LEFT = {
    "left_collar": (0, 0, -5),
    "left_shoulder": (0, -6, -53),
    "left_elbow": (0, -18, -8),
    "left_wrist": (0, -4, -4),
    "left_hip": (0, 4, -4),
    "left_knee": (0, 0, 4),
}
FINGER_CURL = {"index": 14, "middle": 18, "ring": 21, "pinky": 22}  # degrees a phalanx, about z
MAX_FRAMES = 1_000_000


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
        phase = _phase("turn", self.config.seconds, self.config.fps)
        poses = np.repeat(relaxed_pose()[None], len(phase), 0)
        poses[:, SMPLH.index("pelvis"), 1] = 2 * np.pi * phase
        return _motion("turn", poses, np.zeros((len(phase), 3)), self.config.fps)


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
        phase = _phase("wave", self.config.seconds, self.config.fps)
        swing = 2 * np.pi * self.config.waves * phase
        sway = np.sin(2 * np.pi * phase)
        poses = np.repeat(relaxed_pose()[None], len(phase), 0)
        trans = np.zeros((len(phase), 3))
        _lift_right_arm(poses, swing)
        _sway(poses, trans, sway, np.sin(2 * np.pi * phase - 0.6))
        return _motion("wave", poses, trans, self.config.fps)


def relaxed_pose() -> np.ndarray:
    """(52, 3) axis-angle of a person standing at ease, SMPL-H order, radians."""
    pose = np.zeros((len(SMPLH), 3))
    for name, degrees in RELAXED_LEFT.items():
        left = np.radians(degrees)
        pose[SMPLH.index(name)] = left
        pose[SMPLH.index(name.replace("left", "right"))] = left * (1, -1, -1)
    for name in FINGERS:
        side, finger = name.split("_")
        curl = np.radians(FINGER_CURL.get(finger[:-1], 0))
        pose[SMPLH.index(name), 2] = -curl if side == "left" else curl
    return pose


def _lift_right_arm(poses: np.ndarray, swing: np.ndarray) -> None:
    """Write the raised, waving right arm into poses (T, 52, 3); swing (T,) is the wave's phase, radians."""
    collar, shoulder, elbow, wrist = (SMPLH.index(f"right_{n}") for n in ("collar", "shoulder", "elbow", "wrist"))
    side = np.sin(swing)
    poses[:, collar] = np.radians((0, 0, -8))
    # the long axis turned until the forearm, which bends forward in the T-pose, bends upwards with the palm ahead;
    # then the upper arm brought to a little below the horizontal and a little forward
    lifted = np.stack([np.zeros_like(side), np.full_like(side, 22), 5 + 3 * side], -1)
    twist = np.stack([np.full_like(side, -78), np.zeros_like(side), np.zeros_like(side)], -1)
    poses[:, shoulder] = _compose(lifted, twist)
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


def _compose(*degrees: np.ndarray) -> np.ndarray:
    """(..., 3) axis-angle of rotations applied from the last to the first, each (..., 3) in degrees about one axis or
    several."""
    first, *rest = (quaternion_from_axis_angle(np.radians(d)) for d in degrees)
    for q in rest:
        w, v, w2, v2 = first[..., :1], first[..., 1:], q[..., :1], q[..., 1:]
        first = np.concatenate([w * w2 - np.sum(v * v2, -1, keepdims=True), w * v2 + w2 * v + np.cross(v, v2)], -1)
    return axis_angle_from_quaternion(first)


def _phase(name: str, seconds: float, fps: float) -> np.ndarray:
    """(T,) in [0, 1): the loop's phase at each frame, at least one frame."""
    for key, value in (("seconds", seconds), ("fps", fps)):
        if not (isinstance(value, (int, float)) and 0 < value < np.inf):
            raise UserError(f"motion '{name}': {key}={value} must be a positive number")
    frames = max(1, round(seconds * fps))
    if frames > MAX_FRAMES:
        raise UserError(f"motion '{name}': {seconds:g} s at {fps:g} frames per second is more than {MAX_FRAMES} frames")
    return np.arange(frames) / frames


def _motion(name: str, poses: np.ndarray, trans: np.ndarray, fps: float) -> Motion:
    return Motion(poses.astype(np.float32), trans.astype(np.float32), float(fps), name=name)
