"""The built-in motion `jump`."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import WrongValue
from ...values.motion import Motion
from ..source import MOTIONS, MotionSource
from .curves import eased, through
from .figure import ANKLE, HIP, REACH, SIDES, Figure, Foot, planted, rolled
from .standing import loop_phase

GRAVITY = 9.81
# seconds before the flight and after it: standing, going down, pushing off; giving way, straightening, standing
BEFORE, AFTER = (0.15, 0.5, 0.36), (0.3, 0.55, 0.25)
OFF, ON = 50.0, 24.0  # degrees of the heels' lift when the toes leave the floor, and when they touch it again


@dataclasses.dataclass
class JumpOptions:
    """seconds: one loop; the flight takes what the height wants, the rest goes faster or slower. fps: frames per
    second. height: metres that the body rises after the feet left the floor, of a person whose legs are 0.9 m. forward:
    metres that the jump goes ahead."""

    seconds: float = 2.6
    fps: float = 30.0
    height: float = 0.3
    forward: float = 0.0


@MOTIONS.register("jump", config=JumpOptions, summary="crouches, jumps and lands; loops")
class Jump(MotionSource):
    """A jump off both feet: down, arms back; up, arms ahead; a flight as gravity has it; down on the toes, giving way.
    The frame after the last would be the first, as far ahead as it jumped."""

    def __init__(self, config: JumpOptions):
        for name, low, high in (("height", 0.05, 0.6), ("forward", 0.0, 1.0)):
            value = getattr(config, name)
            if isinstance(value, bool) or not (isinstance(value, (int, float)) and low <= value <= high):
                raise WrongValue(f"`{name}={value}`: motion 'jump' is made for {low:g} to {high:g} metres")
        self.config = config

    def load(self) -> Motion:
        c = self.config
        phase = loop_phase("jump", c.seconds, c.fps)
        seconds = len(phase) / c.fps
        near = 0.25 * min(c.forward, 0.6)  # how far ahead of its feet the body is at take-off, and behind them after
        start, end = _standing_height(OFF, near), _standing_height(ON, -near) - 0.05
        rise, fall = np.sqrt(2 * GRAVITY * c.height), np.sqrt(2 * GRAVITY * (c.height + start - end))
        flight = (rise + fall) / GRAVITY
        pace = (seconds - flight) / (sum(BEFORE) + sum(AFTER))
        if len(phase) > 1 and pace < 0.3:
            raise WrongValue(f"`seconds={c.seconds:g}`: a jump of {c.height:g} m takes {flight + 0.65:.1f} s at least")
        pace = max(pace, 0.3)
        times = np.cumsum([0, *(pace * t for t in BEFORE), flight, *(pace * t for t in AFTER)])
        course = _Course(times, near, (start, rise), (end, fall), min(0.34, 0.2 + 0.4 * c.height), c.forward)
        return _drawn(phase * seconds, course).motion("jump", c.fps)


def _standing_height(pitch: float, ahead: float) -> float:
    """Metres of the pelvis above the T-pose's where the legs are straight over feet with their heels lifted."""
    up, on = rolled(np.array(pitch))
    aside = np.hypot(ANKLE[0] - HIP[0], ANKLE[2] + on - HIP[2] - ahead)
    return float(up + ANKLE[1] + np.sqrt((0.998 * REACH) ** 2 - aside**2) - HIP[1])


@dataclasses.dataclass(frozen=True)
class _Course:
    """Where the body goes. times: seconds of the eight moments. near: metres that it is ahead of its feet at take-off
    and behind them at landing. off, on: its height and speed then. depth: metres that it goes down before. forward:
    metres that it goes ahead."""

    times: np.ndarray
    near: float
    off: tuple[float, float]
    on: tuple[float, float]
    depth: float
    forward: float

    def place(self, t: np.ndarray) -> np.ndarray:
        """(T, 3) metres of the pelvis from the T-pose, at seconds t."""
        _, stood, low, away, down, deep, up, _ = self.times
        ease, far = -0.012, self.forward
        height = through(t, (
            (stood, ease, 0), (low, -self.depth, 0), (away, *self.off), (down, self.on[0], -self.on[1]),
            (deep, -0.8 * self.depth, 0), (up, ease, 0),
        ))  # fmt: skip
        speed = (far - 2 * self.near) / (down - away)
        ahead = through(t, (
            (stood, 0, 0), (low, -0.1, 0), (away, self.near, speed), (down, far - self.near, speed),
            (deep, far - 0.1, 0), (up, far, 0),
        ))  # fmt: skip
        return np.stack([np.zeros_like(height), height, ahead], -1)


def _drawn(t: np.ndarray, course: _Course) -> Figure:
    """The figure at seconds t."""
    _, stood, low, away, down, deep, up, _ = course.times
    figure = Figure(len(t))
    figure.place[:] = course.place(t)

    def keyed(*values: float) -> np.ndarray:
        """Through values at rest, lowest, take-off, midway, landing, deepest and rest, level at each."""
        moments = (stood, low, away, (away + down) / 2, down, deep, up)
        return through(t, [(moment, value, 0.0) for moment, value in zip(moments, values, strict=True)])

    figure.tilt(x=keyed(0, 32, 4, 2, 10, 28, 0))
    figure.bend_spine(x=keyed(0, 20, -4, 4, 8, 20, 0))
    figure.turn_head(x=keyed(0, -34, -4, 2, -4, -30, 0))
    figure.turn_both("shoulder", x=keyed(0, 58, -125, -110, -70, -25, 0), z=keyed(0, 6, 14, 12, 8, 6, 0))
    figure.turn_both("collar", z=keyed(0, 0, 12, 8, 2, 0, 0))
    figure.turn_both("elbow", y=keyed(0, -8, -20, -16, -20, -35, 0))
    feet = tuple(_foot(side, t, course) for side in SIDES)
    figure.stand(feet)
    return figure


def _foot(side: str, t: np.ndarray, course: _Course) -> Foot:
    _, _, low, away, down, deep, *_ = course.times
    forward = course.forward
    touch = 0.5 * (deep - down)
    pitch = np.where(t < away, OFF * np.clip((t - low - 0.35 * (away - low)) / (0.65 * (away - low)), 0, 1) ** 1.5, 0)
    pitch = np.where(t >= away, OFF + (ON - OFF) * eased((t - away) / (down - away)), pitch)
    pitch = np.where(t >= down, ON * (1 - eased((t - down) / touch)), pitch)
    still = np.zeros_like(t)
    floor = planted(side, still, np.where(t < (away + down) / 2, 0.0, forward), pitch, still)
    share = np.clip((t - away) / (down - away), 0, 1)[:, None]
    ends = planted(side, np.zeros(2), np.array([0.0, forward]), np.array([OFF, ON]), np.zeros(2)).place
    body, at = course.place(t), course.place(np.array([away, down]))
    # in the air the feet go with the body, from where they left to where they will land, drawn up a little
    flown = body + (ends[0] - at[0]) * (1 - eased(share)) + (ends[1] - at[1]) * eased(share)
    flown[:, 1] += 0.1 * (4 * share * (1 - share))[:, 0] ** 2
    air = (t > away) & (t < down)
    toes = np.where(air, floor.toes * (1 - 4 * share * (1 - share))[:, 0], floor.toes)
    return Foot(np.where(air[:, None], flown, floor.place), pitch, still, toes)
