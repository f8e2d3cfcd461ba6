"""Which Gaussians a camera can see at all, from the posed body alone: before anything is decoded."""

from __future__ import annotations

import numpy as np

from ..values.camera import Camera

FACING = (
    0.5  # cosine: a normal turned away by more is on the far side, however the look leaves the body (52 dB at least)
)
REACH = 0.2  # metres that a Gaussian may reach beyond its point of the body: offset and three deviations


def seen_from(points: np.ndarray, normals: np.ndarray, camera: Camera, facing: float = FACING) -> np.ndarray:
    """(M,) int32, ascending: which of the points may show.

    points: (N, 3) world, metres. normals: (N, 3) world, of length 1 or less (NaN: unknown, kept). facing: a point is
    left out where its normal makes a cosine below -facing with the direction to the camera, or where it lies more than
    `REACH` outside the view. A closed body hides what is left out; what hangs over its rim by more than `facing` allows
    is lost.
    """
    T = camera.T_camera_world.astype(np.float32)
    R, t = T[:3, :3], T[:3, 3]
    x, y, z = R @ points.T + t[:, None]
    center = -R.T @ t
    toward = center - points
    distance = np.sqrt(np.einsum("na,na->n", toward, toward))
    turned = np.einsum("na,na->n", toward, normals) < -facing * distance  # NaN is not less
    hidden = turned | (z < -REACH)
    for value, focal, c, size in ((x, camera.fx, camera.cx, camera.width), (y, camera.fy, camera.cy, camera.height)):
        low, high = -c / focal, (size - c) / focal  # slopes of the view's sides, then metres beyond them
        hidden |= value < low * z - REACH * np.hypot(1, low)
        hidden |= value > high * z + REACH * np.hypot(1, high)
    return np.flatnonzero(~hidden).astype(np.int32)
