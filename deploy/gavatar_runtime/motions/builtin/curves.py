"""Smooth curves through given values, that built-in motions are drawn with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def cyclic(phase: np.ndarray, keys: Sequence[tuple[float, float]]) -> np.ndarray:
    """A curve of period 1 through `keys`, pairs of phase in [0, 1) and value with rising phases, at `phase`.

    Piecewise cubic with a continuous slope, that never leaves the values beside it (Fritsch and Carlson 1980): where a
    key is the highest or lowest of its neighbours the curve is level. One key is a constant.
    """
    x, y = (np.array(column, float) for column in zip(*keys, strict=True))
    if len(x) == 1:
        return np.full(np.shape(phase), y[0])
    x, y = np.append(x, x[0] + 1), np.append(y, y[0])
    width, secant = np.diff(x), np.diff(y) / np.diff(x)
    before, w0 = np.roll(secant, 1), np.roll(width, 1)
    # the harmonic mean of the secants, weighted by their lengths; zero where they differ in sign
    w1, w2 = 2 * width + w0, width + 2 * w0
    same = before * secant > 0
    safe = np.where(same, before * secant, 1)
    slope = np.where(same, safe * (w1 + w2) / np.where(same, w1 * secant + w2 * before, 1), 0)
    slope = np.append(slope, slope[0])
    at = x[0] + np.mod(np.asarray(phase, float) - x[0], 1)
    i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(width) - 1)
    return hermite((at - x[i]) / width[i], y[i], y[i + 1], slope[i] * width[i], slope[i + 1] * width[i])


def hermite(t: np.ndarray, start: np.ndarray, end: np.ndarray, leaving: np.ndarray, arriving: np.ndarray) -> np.ndarray:
    """The cubic with values `start` and `end` and slopes `leaving` and `arriving` at t = 0 and 1."""
    t2, t3 = t * t, t * t * t
    return (
        (2 * t3 - 3 * t2 + 1) * start + (t3 - 2 * t2 + t) * leaving + (3 * t2 - 2 * t3) * end + (t3 - t2) * arriving
    )  # fmt: skip


def eased(t: np.ndarray) -> np.ndarray:
    """From 0 to 1 as t goes there, with speed and acceleration zero at both ends; constant outside."""
    t = np.clip(t, 0, 1)
    return t * t * t * (10 - 15 * t + 6 * t * t)


def through(time: np.ndarray, knots: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """The curve of cubics through `knots`, rising times with a value and a speed each; level outside. A body in free
    flight between two of them flies its parabola."""
    t, value, speed = (np.array(column, float) for column in zip(*knots, strict=True))
    time = np.clip(np.asarray(time, float), t[0], t[-1])
    i = np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 2)
    width = t[i + 1] - t[i]
    return hermite((time - t[i]) / width, value[i], value[i + 1], speed[i] * width, speed[i + 1] * width)
