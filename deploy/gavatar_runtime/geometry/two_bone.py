"""Inverse kinematics of a limb of two bones, in closed form: hip, knee and ankle."""

from __future__ import annotations

import numpy as np

_TINY = 1e-12


def two_bone(
    upper: np.ndarray, lower: np.ndarray, hinge: np.ndarray, target: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How a limb turns so that its end is at `target`.

    upper: (3,) from the first joint (hip) to the middle one (knee), lower: (3,) from there to the end (ankle), both at
    rest, metres. hinge: (3,) the axis at rest that the middle joint turns about, of any length. target: (..., 3) where
    the end shall be, relative to the first joint. across: (..., 3) where the hinge shall point as nearly as the target
    allows. All of one frame.
    Returns the rotation of the upper bone from rest, (..., 3, 3), and the angle of the middle joint about the hinge,
    (...), radians in [0, pi]: positive turns, so the sign of `hinge` says which way the limb bends.
    A target beyond reach, too far or too near, is pointed at: the limb is as long or as short as it can be. A target on
    the first joint has no direction and is taken to be where the rest pose has the end. A bone without length, or one
    along the hinge, does not turn about it: the angle is zero. A limb whose end stays on its first joint is not turned.
    """
    upper, lower = np.asarray(upper, np.float64), np.asarray(lower, np.float64)
    target, across = np.broadcast_arrays(np.asarray(target, np.float64), np.asarray(across, np.float64))
    axis = np.asarray(hinge, np.float64) / max(float(np.linalg.norm(hinge)), _TINY)
    angle = _bend(upper, lower, axis, np.linalg.norm(target, axis=-1))
    end = upper + _turned(lower, axis, angle)
    wanted = np.where(np.linalg.norm(target, axis=-1, keepdims=True) > _TINY, target, upper + lower)
    frames = _frame(wanted, across) @ np.swapaxes(_frame(end, np.broadcast_to(axis, end.shape)), -1, -2)
    still = (np.linalg.norm(end, axis=-1) <= _TINY)[..., None, None]
    return np.where(still, np.eye(3), frames), angle


def longest_reach(upper: np.ndarray, lower: np.ndarray, hinge: np.ndarray) -> float:
    """Metres from the first joint to the end of that limb, as straight as its hinge lets it be."""
    upper, lower = np.asarray(upper, np.float64), np.asarray(lower, np.float64)
    axis = np.asarray(hinge, np.float64) / max(float(np.linalg.norm(hinge)), _TINY)
    angle = _bend(upper, lower, axis, np.array(np.inf))
    return float(np.linalg.norm(upper + _turned(lower, axis, angle)))


def _bend(upper: np.ndarray, lower: np.ndarray, axis: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Angle in [0, pi] at which the end lies `distance` from the first joint, or as near to that as it can.

    The squared distance is |u|^2 + |l|^2 + 2 u . R l, and u . R l = along + a cos(angle) + b sin(angle), which falls
    from its largest value, at atan2(b, a), over the half turn that follows."""
    along = (upper @ axis) * (lower @ axis)
    a = upper @ lower - along
    b = upper @ np.cross(axis, lower)
    size = float(np.hypot(a, b))
    if size <= _TINY:
        return np.zeros_like(distance)
    cosine = ((distance**2 - upper @ upper - lower @ lower) / 2 - along) / size
    angle = np.arctan2(b, a) + np.arccos(np.clip(cosine, -1, 1))
    return np.clip(angle, 0, np.pi)


def _turned(vector: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(..., 3) one vector turned about an axis of length one by angles (...) (Rodrigues)."""
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    return vector * c + np.cross(axis, vector) * s + axis * (axis @ vector) * (1 - c)


def _frame(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(..., 3, 3) right-handed axes in columns: along `first`, as near to `second` as that allows, and across
    both. Where `second` is along `first` or has no length, the coordinate axis that is furthest from it takes its
    place; where `first` has none, y does."""
    x = _unit(first)
    x = np.where(np.linalg.norm(x, axis=-1, keepdims=True) > 0, x, np.eye(3)[1])
    y = second - x * np.sum(second * x, -1, keepdims=True)
    other = np.eye(3)[np.argmin(np.abs(x), -1)]
    other = other - x * np.sum(other * x, -1, keepdims=True)
    size = np.linalg.norm(second, axis=-1, keepdims=True)
    y = _unit(np.where(np.linalg.norm(y, axis=-1, keepdims=True) > 1e-9 * np.maximum(size, _TINY), y, other))
    return np.stack([x, y, np.cross(x, y)], -1)


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.where(length > _TINY, vector / np.maximum(length, _TINY), 0)
