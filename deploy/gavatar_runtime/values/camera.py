"""Pinhole cameras in the OpenCV convention (x right, y down, z forward; pixel centres at integer + 0.5)."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike


@dataclasses.dataclass(frozen=True)
class Camera:
    """A pinhole camera without lens distortion.

    width, height: pixels. fx, fy, cx, cy: pixels; the principal point may be off centre.
    T_camera_world: (4, 4) float64, rigid, metres; a world point x maps to `T_camera_world @ [x, 1]`.
    A point (X, Y, Z) of the camera frame falls on continuous image position (fx X/Z + cx, fy Y/Z + cy); the pixel of
    column j and row i is centred at (j + 0.5, i + 0.5).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    T_camera_world: np.ndarray

    def scaled(self, factor: float) -> Camera:
        """The same view on an image whose sides are `factor` times as long (rounded to whole pixels, at least 1)."""
        width, height = max(1, round(self.width * factor)), max(1, round(self.height * factor))
        return self.resized(width, height)

    def resized(self, width: int, height: int) -> Camera:
        """The same view sampled by `width` x `height` pixels."""
        sx, sy = width / self.width, height / self.height
        return dataclasses.replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """The camera of the sub-image whose top-left pixel is (left, top); parts outside the image are allowed."""
        return dataclasses.replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    @property
    def position(self) -> np.ndarray:
        """(3,) the optical centre in the world, metres."""
        return -self.T_camera_world[:3, :3].T @ self.T_camera_world[:3, 3]

    def project(self, points: np.ndarray) -> np.ndarray:
        """points: (..., 3) world, metres -> (..., 3): x, y in pixels and depth z in metres (not clipped)."""
        camera = points @ self.T_camera_world[:3, :3].T + self.T_camera_world[:3, 3]
        z = camera[..., 2:]
        return np.concatenate(
            [camera[..., :1] / z * self.fx + self.cx, camera[..., 1:2] / z * self.fy + self.cy, z], -1
        )


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> np.ndarray:
    """(4, 4) T_camera_world of a camera at `eye` looking at `target`, both (3,) in the world; `up` need not be
    perpendicular. Raises ValueError when eye and target coincide."""
    eye, target, up = (np.asarray(v, np.float64) for v in (eye, target, up))
    forward = target - eye
    norm = np.linalg.norm(forward)
    if not norm > 0:
        raise ValueError("look_at: eye and target coincide")
    forward = forward / norm
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # looking along `up`: any horizontal axis will do
        right = np.cross(forward, np.roll(up, 1))
    right = right / np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = -rotation @ eye
    return T
