"""A body that built-in motions are drawn on: turned joint by joint, its legs bent for feet that are told where to be.

Lengths are of one body, the free body that comes with gavatar, made symmetric; who plays a motion walks in proportion
to their own legs (`Motion.leg_length`). The pelvis of the T-pose is the origin; x is to the left, y up, z ahead.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from ...geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from ...geometry.two_bone import longest_reach, two_bone
from ...values.motion import Motion
from ...values.skeletons import SMPLH
from .curves import eased
from .standing import composed, motion_of, relaxed_pose

SIDES = ("left", "right")
# metres, of the left side
HIP, KNEE, ANKLE = np.array([(0.1186, -0.0503, -0.0099), (0.1810, -0.4913, -0.0233), (0.1313, -0.9380, -0.0594)])
LEG_LENGTH = float(np.linalg.norm(KNEE - HIP) + np.linalg.norm(ANKLE - KNEE))
REACH = longest_reach(KNEE - HIP, ANKLE - KNEE, np.eye(3)[0])  # less: a straight knee is not quite in line with both
FLOOR = -1.0205  # height of the soles
SOLE = float(ANKLE[1] - FLOOR)  # of the ankle over the floor, feet level
TOES = np.array([-0.0539, 0.1548])  # y, z from the ankle to the joint that the toes bend at
# The outline of a sole from the heel to the tips of the toes: y, z from the ankle, and the toes' share in its skinning.
SOLE_POINTS = np.array([
    (-0.0452, -0.0589, 0), (-0.0586, -0.0577, 0), (-0.0686, -0.0541, 0), (-0.0745, -0.0498, 0), (-0.0782, -0.0428, 0),
    (-0.0799, -0.0387, 0), (-0.0813, -0.0290, 0), (-0.0818, -0.0227, 0), (-0.0825, -0.0143, 0), (-0.0814, 0.1050, 0),
    (-0.0825, 0.1321, 0.5), (-0.0824, 0.1889, 0.5), (-0.0820, 0.1938, 0.5), (-0.0813, 0.2044, 0.5),
    (-0.0804, 0.2069, 0.5), (-0.0790, 0.2106, 1), (-0.0776, 0.2124, 1), (-0.0709, 0.2174, 1),
])  # fmt: skip
ROUNDED = 0.006  # metres
KNEES_IN = 8.0  # degrees that knees bend inwards of where the foot points
PITCHES = np.arange(-60, 100.25, 0.25)  # degrees, at which the rolling of a sole is tabled


@dataclasses.dataclass(frozen=True)
class Foot:
    """The path of a foot over T frames: place (T, 3) of the ankle, metres; pitch, yaw (T,) degrees: the heel lifted
    about the side-to-side axis, the toes turned to the left; toes (T,) degrees that they bend, upwards negative."""

    place: np.ndarray
    pitch: np.ndarray
    yaw: np.ndarray
    toes: np.ndarray


def rolled(pitch: np.ndarray) -> np.ndarray:
    """(..., 2) metres up and ahead, how far the ankle of a planted foot is from where it is when the foot is level.

    pitch: (...) degrees. The sole rolls over its outline without slipping: over the round of the heel while the toes
    are up, over the toes, which bend so as to stay on the floor, while the heel is.
    """
    up, ahead = _rolling()
    return np.stack([np.interp(pitch, PITCHES, up), np.interp(pitch, PITCHES, ahead)], -1)


def clearing(pitch: np.ndarray, toes: np.ndarray) -> np.ndarray:
    """(...) metres from the lowest point of a foot up to its ankle. pitch, toes: (...) degrees, as `Foot` has them."""
    return -_outline(pitch, toes)[..., 0].min(-1)


@functools.cache
def _rolling() -> tuple[np.ndarray, np.ndarray]:
    """Up and ahead of the ankle at each of `PITCHES`: whatever is lowest on the way from one to the next stays where it
    is."""
    points = _outline(PITCHES, -np.maximum(PITCHES, 0))
    lowest = np.argmin(points[:-1, :, 0] + points[1:, :, 0], 1)
    rows = np.arange(len(lowest))
    moved = points[rows + 1, lowest, 1] - points[rows, lowest, 1]
    ahead = np.append(0, np.cumsum(-moved))
    return -points[..., 0].min(1) - SOLE, ahead - ahead[np.argmin(np.abs(PITCHES))]


def _outline(pitch: np.ndarray, toes: np.ndarray) -> np.ndarray:
    """(..., K, 2) metres up and ahead from the ankle to the points of a sole."""

    def turned(points: np.ndarray, degrees: np.ndarray) -> np.ndarray:
        c, s = np.cos(np.radians(degrees))[..., None], np.sin(np.radians(degrees))[..., None]
        y, z = points[:, 0], points[:, 1]
        return np.stack([y * c - z * s, y * s + z * c], -1)

    points, share = SOLE_POINTS[:, :2], SOLE_POINTS[:, 2:]
    bent = turned(TOES[None], pitch) + turned(points - TOES, np.asarray(pitch) + toes)
    return (1 - share) * turned(points, np.asarray(pitch)) + share * bent


def planted(side: str, x: np.ndarray, z: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> Foot:
    """A foot on the floor. x, z: (T,) metres from where it is in the T-pose, to the left and ahead, of the ankle when
    the foot is level. pitch, yaw: as `Foot` has them; the toes stay flat."""
    sign = 1 if side == "left" else -1
    roll = rolled(pitch)
    turn = np.radians(yaw)
    level = np.stack([sign * ANKLE[0] + x, np.full_like(turn, ANKLE[1]), ANKLE[2] + z], -1)
    ahead = np.stack([np.sin(turn), np.zeros_like(turn), np.cos(turn)], -1)
    place = level + roll[:, 1:] * ahead
    place[:, 1] += roll[:, 0]
    return Foot(place, pitch, yaw, -np.maximum(pitch, 0))


def stepping_aside(
    side: str, time: np.ndarray, period: float, steps: Sequence[tuple[float, float, float, float]], lift: float = 0.05
) -> Foot:
    """A foot that is planted but while it steps. time: (T,), which repeats after `period`. steps: when each begins and
    ends, and the x and z where it goes, as `planted` has them; the first begins where the last ended. lift: metres."""
    time = np.mod(time, period)
    x, z, up, pitch = np.zeros((4, len(time)))
    x0, z0 = steps[-1][2:]
    x, z = x + x0, z + z0
    for start, end, x1, z1 in steps:
        share = (time - start) / (end - start)
        moved = eased(share)
        x, z = x + (x1 - x0) * moved, z + (z1 - z0) * moved
        free = (share > 0) & (share < 1)
        arch = np.where(free, np.clip(4 * share * (1 - share), 0, 1), 0)
        pitch, up = pitch + 18 * arch, up + lift * arch**0.75
        x0, z0 = x1, z1
    foot = planted(side, x, z, np.zeros_like(x), np.zeros_like(x))
    toes = -0.5 * pitch
    place = foot.place.copy()
    place[:, 1] += clearing(pitch, toes) - SOLE + up
    return Foot(place, pitch, foot.yaw, toes)


class Figure:
    """T frames of a body at ease.

    place: (T, 3) metres, of the pelvis from the T-pose; to be written. pelvis: (T, 3, 3), its turn, set by `tilt`.
    """

    def __init__(self, count: int):
        self.poses = np.repeat(relaxed_pose()[None], count, 0)
        self.place = np.zeros((count, 3))
        self.pelvis = np.broadcast_to(np.eye(3), (count, 3, 3))

    def turn(self, name: str, x: np.ndarray | float = 0, y: np.ndarray | float = 0, z: np.ndarray | float = 0) -> None:
        """Turn a joint further, by degrees about the axes of its parent, each (T,) or one number."""
        row = SMPLH.index(name)
        degrees = np.stack(
            np.broadcast_arrays(*(np.asarray(v, float) for v in (x, y, z)), np.zeros(len(self.poses)))[:3], -1
        )
        self.poses[:, row] = composed(degrees, np.degrees(self.poses[:, row]))

    def turn_both(
        self, part: str, x: np.ndarray | float = 0, y: np.ndarray | float = 0, z: np.ndarray | float = 0
    ) -> None:
        """The same of a joint of the left side, mirrored on the right."""
        self.turn(f"left_{part}", x, y, z)
        self.turn(f"right_{part}", x, -np.asarray(y), -np.asarray(z))

    def bend_spine(
        self, x: np.ndarray | float = 0, y: np.ndarray | float = 0, z: np.ndarray | float = 0,
        shares: Sequence[float] = (0.3, 0.35, 0.35),
    ) -> None:  # fmt: skip
        """Turn the chest against the pelvis, over the three joints of the spine."""
        for name, share in zip(("spine1", "spine2", "spine3"), shares, strict=True):
            self.turn(name, *(share * np.asarray(v) for v in (x, y, z)))

    def turn_head(self, x: np.ndarray | float = 0, y: np.ndarray | float = 0, z: np.ndarray | float = 0) -> None:
        """Turn the head against the chest, half in the neck."""
        for name in ("neck", "head"):
            self.turn(name, *(0.5 * np.asarray(v) for v in (x, y, z)))

    def tilt(self, x: np.ndarray | float = 0, y: np.ndarray | float = 0, z: np.ndarray | float = 0) -> None:
        """Turn the pelvis, and all that hangs on it, by degrees about the world's axes."""
        self.turn("pelvis", x, y, z)
        self.pelvis = matrix_from_axis_angle(self.poses[:, 0])

    def settle(self, feet: Sequence[Foot], bearing: np.ndarray, *, straight: float = 0.998, whole: bool = True) -> None:
        """Lower the body, so that no leg that bears weight need be longer than a share of what it can be.

        feet: left and right. bearing: (T, 2) whether they do. whole: as much at every frame; else what each needs,
        rounded off by some millimetres.
        """
        drops = []
        for i, foot in enumerate(feet):
            hip = self._hip(i)
            aside = np.sum((foot.place - hip)[:, [0, 2]] ** 2, 1)
            highest = foot.place[:, 1] + np.sqrt(np.maximum((straight * REACH) ** 2 - aside, 0))
            drops.append(np.where(bearing[:, i], hip[:, 1] - highest, -1.0))
        drop = np.max(drops, 0)
        self.place[:, 1] -= max(0.0, float(drop.max())) if whole else ROUNDED * np.logaddexp(0, drop / ROUNDED)

    def stand(self, feet: Sequence[Foot]) -> None:
        """Bend the legs so that the feet, left and right, are where they shall be."""
        for i, (side, foot) in enumerate(zip(SIDES, feet, strict=True)):
            mirror = np.array([1 - 2 * i, 1, 1])
            turn = np.radians(np.stack([0 * foot.yaw, foot.yaw, 0 * foot.yaw], -1))
            heading = matrix_from_axis_angle(turn)
            inwards = np.radians(KNEES_IN) * (2 * i - 1) * np.eye(3)[1]
            across = (heading @ matrix_from_axis_angle(inwards))[..., 0]
            target = foot.place - self._hip(i)
            thigh, knee = two_bone((KNEE - HIP) * mirror, (ANKLE - KNEE) * mirror, np.eye(3)[0], target, across)
            bent = np.stack([knee, 0 * knee, 0 * knee], -1)
            shin = thigh @ matrix_from_axis_angle(bent)
            pitch = np.radians(foot.pitch)
            sole = heading @ matrix_from_axis_angle(np.stack([pitch, 0 * pitch, 0 * pitch], -1))
            toes = np.radians(np.stack([foot.toes, 0 * foot.toes, 0 * foot.toes], -1))
            turns = {
                "hip": axis_angle_from_matrix(np.swapaxes(self.pelvis, 1, 2) @ thigh), "knee": bent,
                "ankle": axis_angle_from_matrix(np.swapaxes(shin, 1, 2) @ sole), "foot": toes,
            }  # fmt: skip
            for joint, value in turns.items():
                self.poses[:, SMPLH.index(f"{side}_{joint}")] = value

    def _hip(self, i: int) -> np.ndarray:
        return self.place + self.pelvis @ (HIP * (1 - 2 * i, 1, 1))

    def motion(self, name: str, fps: float) -> Motion:
        """What was drawn."""
        return dataclasses.replace(motion_of(name, self.poses, self.place, fps), leg_length=LEG_LENGTH)
