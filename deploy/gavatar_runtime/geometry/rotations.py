"""Rotations in NumPy, right at zero, at pi and beyond."""

from __future__ import annotations

import numpy as np


def quaternion_from_axis_angle(axis_angle: np.ndarray) -> np.ndarray:
    """(..., 3) axis-angle, radians -> (..., 4) unit quaternions wxyz. Exact limit at zero, any angle."""
    axis_angle = np.asarray(axis_angle)
    dtype = axis_angle.dtype
    if dtype == np.float16:  # squares of angles above 256 are beyond it
        axis_angle = axis_angle.astype(np.float32)
    angle = np.linalg.norm(axis_angle, axis=-1, keepdims=True)
    # np.sinc(x) = sin(pi x)/(pi x): sin(angle/2)/angle with the right limit 1/2 at zero
    factor = 0.5 * np.sinc(angle / (2 * np.pi))
    return np.concatenate([np.cos(angle / 2), axis_angle * factor], -1).astype(dtype, copy=False)


def axis_angle_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """(..., 4) wxyz, need not be normalised -> (..., 3) axis-angle with angle in [0, pi], radians."""
    q = np.asarray(quaternion)
    q = np.where(q[..., :1] < 0, -q, q)
    norm = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(norm, q[..., :1])
    # below, the angle is 2 norm / w to the last digit, and the division is 0/0 at zero
    tiny = norm < 4 * np.finfo(q.dtype).tiny ** 0.5
    factor = np.where(tiny, 2 / np.where(tiny, q[..., :1], 1), angle / np.where(tiny, 1, norm))
    return (q[..., 1:] * factor).astype(q.dtype, copy=False)


def quaternion_product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(..., 4) wxyz, the rotation `second` followed by `first`."""
    w, v, w2, v2 = first[..., :1], first[..., 1:], second[..., :1], second[..., 1:]
    return np.concatenate([w * w2 - np.sum(v * v2, -1, keepdims=True), w * v2 + w2 * v + np.cross(v, v2)], -1)


def matrix_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """(..., 4) wxyz, normalised here -> (..., 3, 3). A zero quaternion gives the identity, NaN stays NaN."""
    q = np.asarray(quaternion)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(norm == 0, np.array([1, 0, 0, 0], q.dtype), q / np.where(norm == 0, 1, norm))
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def matrix_from_axis_angle(axis_angle: np.ndarray) -> np.ndarray:
    """(..., 3) radians -> (..., 3, 3) rotation matrices (Rodrigues), through unit quaternions."""
    return matrix_from_quaternion(quaternion_from_axis_angle(axis_angle))


def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations -> (..., 4) wxyz with w >= 0, by the largest of the four components (Shepperd)."""
    m = np.asarray(matrix)
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    d21, d02, d10 = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    s01, s02, s12 = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    candidates = np.stack(
        [
            np.stack([1 + m00 + m11 + m22, d21, d02, d10], -1),
            np.stack([d21, 1 + m00 - m11 - m22, s01, s02], -1),
            np.stack([d02, s01, 1 - m00 + m11 - m22, s12], -1),
            np.stack([d10, s02, s12, 1 - m00 - m11 + m22], -1),
        ],
        -2,
    )
    best = np.argmax(np.einsum("...ii->...i", candidates), -1)
    q = np.take_along_axis(candidates, best[..., None, None], -2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def axis_angle_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations -> (..., 3) axis-angle with angle in [0, pi], radians."""
    return axis_angle_from_quaternion(quaternion_from_matrix(matrix))


def rotation_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(..., 3, 3) the least rotation that turns direction `start` to direction `end`, (..., 3) of any length.

    Of opposite directions it is half a turn about what is left of x (of y, where they lie near x) at right angles to
    them. A zero vector has no direction: the identity.
    """
    dtype = np.result_type(start, end, np.float16)
    a, b = np.broadcast_arrays(_direction(start), _direction(end))
    cross, cosine = np.cross(a, b), np.sum(a * b, -1, keepdims=True)
    sine = np.linalg.norm(cross, axis=-1, keepdims=True)
    other = np.where(np.abs(a[..., :1]) < 0.9, np.eye(3)[0], np.eye(3)[1])
    aside = other - a * np.sum(a * other, -1, keepdims=True)
    axis = _direction(np.where((sine < 1e-9) & (cosine < 0), aside, cross))
    return matrix_from_axis_angle(axis * np.arctan2(sine, cosine)).astype(dtype)


def _direction(vector: np.ndarray) -> np.ndarray:
    """float64 of length one, or zero; also of vectors so long or short that their square is none of float64's."""
    vector = np.asarray(vector, np.float64)
    largest = np.abs(vector).max(-1, keepdims=True)
    vector = vector / np.where(largest == 0, 1, largest)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector / np.where(length == 0, 1, length)


def slerp(start: np.ndarray, end: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Shortest-arc interpolation of unit quaternions (..., 4) wxyz; fraction broadcasts against (...)."""
    start, end = np.asarray(start), np.asarray(end)
    dot = np.sum(start * end, -1, keepdims=True)
    end = np.where(dot < 0, -end, end)
    dot = np.minimum(np.abs(dot), 1)
    angle = np.arccos(dot)
    t = np.asarray(fraction)[..., None]
    sine = np.sin(angle)
    near = sine < 1e-6  # fall back to a normalised lerp
    safe = np.where(near, 1, sine)
    a = np.where(near, 1 - t, np.sin((1 - t) * angle) / safe)
    b = np.where(near, t, np.sin(t * angle) / safe)
    q = a * start + b * end
    return q / np.linalg.norm(q, axis=-1, keepdims=True)
