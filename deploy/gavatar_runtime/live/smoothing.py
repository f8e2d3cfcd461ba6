"""Less tremble at a known delay: the One Euro filter, on the rotations of joints and on places.

Source: Casiez, Roussel and Vogel, "1 Euro Filter: A Simple Speed-based Low-pass Filter for Noisy Input in Interactive
Systems", CHI 2012. A first-order low-pass filter whose cutoff rises with speed: what rests does not tremble, what moves
does not lag.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..geometry.rotations import (
    axis_angle_from_quaternion,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_axis_angle,
    quaternion_from_matrix,
    slerp,
)

LONGEST = 0.5  # seconds between two pictures, above which the one before says nothing of speed


@dataclasses.dataclass(frozen=True)
class Cutoff:
    """rest: Hz at rest. rise: Hz for each unit (radian or metre) a second. speed: Hz of the filter of the speed."""

    rest: float
    rise: float
    speed: float = 2.0

    def delay(self, speed: float = 0.0) -> float:
        """Seconds by which something that moves steadily at `speed` is shown late: the filter's time constant,
        1 / (2 pi cutoff). Of something that steps, 63 % is shown after it."""
        return 1 / (2 * np.pi * (self.rest + self.rise * speed))

    def share(self, dt: float, speed: np.ndarray) -> np.ndarray:
        """How much of what is new is taken, in (0, 1]: exact for any time between two pictures."""
        return dt / (dt + 1 / (2 * np.pi * (self.rest + self.rise * speed)))


# By benchmarks/live.py: above, the filter's lag costs more than the tremble it takes
TURNS, PLACES = Cutoff(rest=1.5, rise=1.5), Cutoff(rest=1.0, rise=3.0)


class Rotations:
    """One Euro filter of the rotations of J joints, by the angle between them. What is NaN counts as not seen: that
    joint stays."""

    def __init__(self, cutoff: Cutoff = TURNS):
        self.cutoff = cutoff
        self.reset()

    def reset(self) -> None:
        """Take the next rotations as they are."""
        self._shown: np.ndarray | None = None
        self._last: np.ndarray | None = None
        self._speed: np.ndarray | None = None
        self._time = -np.inf

    def __call__(self, pose: np.ndarray, time: float) -> np.ndarray:
        """(J, 3) axis-angle, radians. time: seconds; not later than the one before changes nothing."""
        new = quaternion_from_axis_angle(np.asarray(pose, np.float64))
        known = np.isfinite(new).all(-1)
        if self._shown is None:
            new[~known] = [1, 0, 0, 0]
            self._shown = self._last = new
            self._speed, self._time = np.zeros((len(new), 3)), time
        dt = time - self._time
        if dt > 0 and self._last is not None and self._speed is not None:
            new[~known] = self._last[~known]
            turned = _between(self._last, new) / dt if dt < LONGEST else np.zeros_like(self._speed)
            share = dt / (dt + 1 / (2 * np.pi * self.cutoff.speed))
            self._speed = self._speed + share * (turned - self._speed)
            fraction = self.cutoff.share(dt, np.linalg.norm(self._speed, axis=-1))
            self._shown = np.where(known[:, None], slerp(self._shown, new, fraction), self._shown)
            self._last, self._time = new, time
        return axis_angle_from_quaternion(self._shown)


class Places:
    """One Euro filter of a place (3,), by its distance. What is NaN counts as not seen."""

    def __init__(self, cutoff: Cutoff = PLACES):
        self.cutoff = cutoff
        self.reset()

    def reset(self) -> None:
        """Take the next place as it is."""
        self._shown: np.ndarray | None = None
        self._last = self._speed = np.zeros(3)
        self._time = -np.inf

    def __call__(self, place: np.ndarray, time: float) -> np.ndarray:
        """(3,) metres. time: seconds; not later than the one before changes nothing."""
        place = np.asarray(place, np.float64)
        if not np.isfinite(place).all():
            return np.zeros(3) if self._shown is None else self._shown
        if self._shown is None:
            self._shown = self._last = place
            self._speed, self._time = np.zeros(3), time
        dt = time - self._time
        if dt > 0:
            moved = (place - self._last) / dt if dt < LONGEST else np.zeros(3)
            self._speed = self._speed + dt / (dt + 1 / (2 * np.pi * self.cutoff.speed)) * (moved - self._speed)
            share = self.cutoff.share(dt, np.asarray(np.linalg.norm(self._speed)))
            self._shown = self._shown + share * (place - self._shown)
            self._last, self._time = place, time
        return self._shown


def _between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(J, 3) axis-angle of the least turn from unit quaternions `start` to `end`."""
    R = np.swapaxes(matrix_from_quaternion(start), -1, -2) @ matrix_from_quaternion(end)
    return axis_angle_from_quaternion(quaternion_from_matrix(R))


def blended(pose: np.ndarray, other: np.ndarray, share: float) -> np.ndarray:
    """(J, 3) axis-angle between two poses, each joint by the shortest turn; share: 0 is `pose`, 1 is `other`."""
    a, b = (quaternion_from_matrix(matrix_from_axis_angle(np.asarray(p, np.float64))) for p in (pose, other))
    return axis_angle_from_quaternion(slerp(a, b, np.full(len(a), share)))
