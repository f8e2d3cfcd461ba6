"""The cameras.json of a capture whose camera moves: a pose a frame."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.values.camera import Camera

NUMBERS = ("fx", "fy", "cx", "cy")


def read_moving(path: Path, cameras: dict[str, Camera], frames: int) -> dict[str, list[Camera]]:
    """The cameras of each frame, by name, of those of `cameras` that have an entry `per_frame`. Raises UserError naming
    file, camera and field for what is not finite or not of so many frames."""
    moving = {}
    for name, entry in json.loads(path.read_text(encoding="utf-8")).items():
        if name not in cameras or not isinstance(entry, dict) or "per_frame" not in entry:
            continue
        given, camera = entry["per_frame"], cameras[name]
        if not isinstance(given, dict) or "world_to_camera" not in given:
            raise UserError(f"{path}: camera '{name}': per_frame must be an object with world_to_camera of each frame")
        T = _array(path, name, "world_to_camera", given["world_to_camera"], (frames, 4, 4))
        values = {key: _array(path, name, key, given[key], (frames,)) for key in NUMBERS if key in given}
        for key in ("fx", "fy"):
            if key in values and not (values[key] > 0).all():
                raise UserError(f"{path}: camera '{name}': per_frame.{key} must be positive")
        fx, fy, cx, cy = (values.get(key, np.full(frames, getattr(camera, key))) for key in NUMBERS)
        moving[name] = [
            Camera(camera.width, camera.height, float(fx[t]), float(fy[t]), float(cx[t]), float(cy[t]), T[t])
            for t in range(frames)
        ]
    return moving


def _array(path: Path, camera: str, field: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise UserError(
            f"{path}: camera '{camera}': per_frame.{field} must hold finite numbers of shape {shape}, "
            "one a frame of body.npz"
        )
    return array
