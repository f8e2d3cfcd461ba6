"""What formats for Gaussians store of them: logits, logarithms, harmonics, axes."""

from __future__ import annotations

import numpy as np

from ...values.gaussians import Gaussians

HARMONIC = 0.28209479177387814  # the spherical harmonic of degree 0, 1 / (2 sqrt(pi))
# Logit and logarithm are infinite at the ends: clamped to what no pixel of 8 bits shows.
OPACITY_EDGE = 1e-6  # from 0 and from 1
SMALLEST = 1e-6  # metres


def logit(opacities: np.ndarray) -> np.ndarray:
    """float64; finite at 0 and 1."""
    inner = np.clip(np.asarray(opacities, np.float64), OPACITY_EDGE, 1 - OPACITY_EDGE)
    return np.log(inner / (1 - inner))


def opacities(gaussians: Gaussians) -> np.ndarray:
    """(N,) in [0, 1]."""
    return np.ones(len(gaussians)) if gaussians.opacities is None else np.clip(gaussians.opacities, 0, 1)


def axes(gaussians: Gaussians) -> np.ndarray:
    """(N, 3) standard deviations in metres, thrice the same where Gaussians are round."""
    scales = gaussians.scales
    return np.repeat(scales[:, None], 3, 1) if scales.ndim == 1 else scales


def log_axes(gaussians: Gaussians) -> np.ndarray:
    """(N, 3) natural logarithms of `axes`, finite at 0."""
    return np.log(np.maximum(axes(gaussians), SMALLEST))


def harmonics(gaussians: Gaussians) -> np.ndarray:
    """(N, 3) coefficients of degree 0: colour = 0.5 + HARMONIC coefficient."""
    return (gaussians.colors - 0.5) / HARMONIC


def unit_quaternions(gaussians: Gaussians) -> np.ndarray:
    """(N, 4) float64 wxyz of length 1; a zero one is the identity, as for rasterizers."""
    if gaussians.quaternions is None:
        return np.tile([1.0, 0, 0, 0], (len(gaussians), 1))
    q = np.asarray(gaussians.quaternions, np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(length == 0, [1.0, 0, 0, 0], q / np.where(length == 0, 1, length))


def y_down(points: np.ndarray) -> np.ndarray:
    """(N, 3) points of our world (y up) after half a turn about z: y points down, as in the scenes that 3DGS learns.
    Viewers that stand such files upright (PlayCanvas, SuperSplat) turn them back."""
    return points * np.array([-1, -1, 1], np.float32)


def turned_y_down(quaternions: np.ndarray) -> np.ndarray:
    """(N, 4) wxyz, after the half turn of `y_down`: the product k q. Round or axis-aligned Gaussians look the same."""
    w, x, y, z = quaternions.T
    return np.stack([-z, -y, x, w], -1)


def largest_dropped(quaternions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For unit quaternions (N, 4): which component is the largest, (N,), and the others in their order, (N, 3), within
    sqrt(1/2) of zero, of the one of q and -q whose largest is positive."""
    largest = np.argmax(np.abs(quaternions), 1)
    rows = np.arange(len(quaternions))
    positive = np.where(quaternions[rows, largest] < 0, -1, 1)[:, None] * quaternions
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    return largest, np.take_along_axis(positive, others, 1)
