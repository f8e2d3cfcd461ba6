"""Several avatars in one picture: where each stands, and how long all of them play."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..avatar.played import PlayedAvatar
from ..bundle import Bundle
from ..errors import WrongValue
from ..geometry.rotations import (
    axis_angle_from_quaternion,
    matrix_from_axis_angle,
    quaternion_from_axis_angle,
    quaternion_product,
)
from ..values.motion import Motion
from .defaults import DEFAULT_FPS
from .staging import Clip

FARTHEST = 1e3  # metres


@dataclasses.dataclass(frozen=True)
class Place:
    """Where a person stands and faces. x, z: metres on the floor, of where the motion begins to count; z is where a
    person faces who is not turned, x is to their left. heading: degrees to their left. Raises WrongValue for what is no
    number or farther than a kilometre."""

    x: float = 0.0
    z: float = 0.0
    heading: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value, most = getattr(self, field.name), 1e6 if field.name == "heading" else FARTHEST
            number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
            if not (number and math.isfinite(value) and abs(value) <= most):
                raise WrongValue(f"a place has `{field.name}={value}`: give a number of at most {most:g}")

    def of(self, motion: Motion, pelvis: np.ndarray) -> Motion:
        """The motion at this place; itself at the origin. motion: fitted to a body. pelvis: (3,) the rest place of that
        body's root joint, which its poses turn about."""
        if not (self.x or self.z or self.heading):
            return motion
        turn = np.array([0, np.radians(self.heading), 0])
        trans = (motion.trans + pelvis) @ matrix_from_axis_angle(turn).T - pelvis + (self.x, 0, self.z)
        poses = motion.poses.copy()
        root = quaternion_from_axis_angle(motion.poses[:, 0].astype(np.float64))
        poses[:, 0] = axis_angle_from_quaternion(quaternion_product(quaternion_from_axis_angle(turn)[None], root))
        return dataclasses.replace(motion, poses=poses, trans=trans.astype(motion.trans.dtype))


@dataclasses.dataclass(frozen=True)
class Companion:
    """Another avatar in the picture. avatar: a bundle, its path, or an avatar, which is played as it was opened.
    motion: of its own, as `perform` takes them, the default one if None. place: where it stands. tier: how it is
    decoded, None as the first avatar."""

    avatar: str | os.PathLike | Bundle | PlayedAvatar
    motion: str | Path | Motion | Sequence[str | Path | Motion] | None = None
    place: Place = Place()
    tier: str | None = None


def abreast(clip: Clip, motions: Sequence[Motion]) -> Clip:
    """The clip that all motions are played by: at one rate, the highest of theirs up to 30 unless it says another, and,
    unless it says how long, as long as the longest; the others repeat."""
    fps = clip.fps or min(max(motion.fps for motion in motions), DEFAULT_FPS)
    seconds = clip.seconds or max(len(motion.resampled(fps)) for motion in motions) / fps
    return dataclasses.replace(clip, fps=fps, seconds=seconds)
