"""Calibrated cameras as filmed, and taking their lens' distortion out."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.values.camera import Camera


@dataclasses.dataclass(frozen=True)
class Lens:
    """A calibrated camera as filmed: the pinhole part and OpenCV's k1, k2, p1, p2 (all zero: no distortion)."""

    camera: Camera
    distortion: np.ndarray

    def undistort_points(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) filmed pixels -> the pixels a lens without distortion would have given."""
        c = self.camera
        K = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])
        flat = np.ascontiguousarray(points.reshape(-1, 1, 2), np.float64)
        return cv2.undistortPoints(flat, K, self.distortion, P=K).reshape(points.shape)

    def undistort_image(self, image: np.ndarray) -> np.ndarray:
        """The image without distortion, same size and focal length; black where the lens saw nothing."""
        c = self.camera
        K = np.array([[c.fx, 0, c.cx - 0.5], [0, c.fy, c.cy - 0.5], [0, 0, 1]])  # cv2 has pixel centres at integers
        return cv2.undistort(image, K, self.distortion) if np.any(self.distortion) else image


def read_lenses(path: Path) -> dict[str, Lens]:
    """Read cameras.json: width, height, fx, fy, cx, cy, world_to_camera (4x4) and, where the lens distorts,
    distortion_k1_k2_p1_p2. Raises UserError naming camera and field."""
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
        items = list(entries.items())
    except FileNotFoundError:
        raise UserError(f"{path} is missing: give the calibrated cameras as `cameras`") from None
    except (json.JSONDecodeError, UnicodeDecodeError, AttributeError) as error:
        raise UserError(f"{path} is not a JSON object of cameras: {error}") from None
    lenses = {}
    for name, entry in items:
        try:
            T = np.asarray(entry["world_to_camera"], np.float64)
            fx, fy, cx, cy = (float(entry[key]) for key in ("fx", "fy", "cx", "cy"))
            camera = Camera(int(entry["width"]), int(entry["height"]), fx, fy, cx, cy, T)
            distortion = np.asarray(entry.get("distortion_k1_k2_p1_p2", [0, 0, 0, 0]), np.float64)
        except KeyError as error:
            raise UserError(f"{path}: camera '{name}' has no field {error}") from None
        except (TypeError, ValueError, AttributeError) as error:
            raise UserError(f"{path}: camera '{name}' has a field of the wrong type ({error})") from None
        rigid = (
            T.shape == (4, 4) and np.isfinite(T).all() and np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3)
        )
        if not rigid:
            raise UserError(f"{path}: camera '{name}': world_to_camera must be a rigid 4x4 matrix")
        if not (camera.width > 0 and camera.height > 0 and camera.fx > 0 and camera.fy > 0):
            raise UserError(f"{path}: camera '{name}': width, height, fx and fy must be positive")
        if distortion.shape != (4,) or not np.isfinite(distortion).all():
            raise UserError(f"{path}: camera '{name}': distortion_k1_k2_p1_p2 must be four finite numbers")
        lenses[name] = Lens(camera, distortion)
    if not lenses:
        raise UserError(f"{path} holds no camera")
    return lenses
