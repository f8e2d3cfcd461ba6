"""Cameras on disk: the cameras.json of a capture, or one camera by itself."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .camera import Camera
from .errors import UserError, did_you_mean

FIELDS = ("width", "height", "fx", "fy", "cx", "cy", "world_to_camera")


def read_cameras(path: str | os.PathLike, fault: Callable[[str], None] | None = None) -> dict[str, Camera]:
    """The cameras of a JSON file by name: {name: {width, height, fx, fy, cx, cy, world_to_camera (4 x 4)}}, or one such
    camera without a name around it, which is then called `camera`. Pixels, metres, OpenCV axes.

    Raises UserError naming file, camera and field; with `fault` each camera's is handed to it instead, and the camera
    left out.
    """
    path = Path(path)
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"camera file {path} does not exist") from None
    except OSError as error:
        raise UserError(f"camera file {path} cannot be read: {error.strerror}") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not valid JSON: {error}") from None
    if isinstance(values, dict) and "world_to_camera" in values:
        values = {"camera": values}
    if not isinstance(values, dict) or not values:
        raise UserError(f"{path} holds no camera: expected an object of cameras by name")
    cameras = {}
    for name, entry in values.items():
        try:
            cameras[name] = _camera(path, name, entry)
        except UserError as error:
            if fault is None:
                raise
            fault(str(error))
    return cameras


def read_camera(source: str) -> Camera:
    """The camera `FILE.json:NAME`, or the only or first one of `FILE.json`."""
    match = re.fullmatch(r"(.+?\.json)(?::(.+))?", source, re.IGNORECASE)
    if match is None:
        raise UserError(f"camera '{source}' is not of the form FILE.json or FILE.json:NAME")
    path, name = match.groups()
    cameras = read_cameras(path)
    if name is None:
        return next(iter(cameras.values()))
    if name not in cameras:
        raise UserError(f"{path} has no camera '{name}': {did_you_mean(name, cameras)}")
    return cameras[name]


def _camera(path: Path, name: str, entry: object) -> Camera:
    if not isinstance(entry, dict):
        raise UserError(f"{path}: camera '{name}' must be an object with the fields {', '.join(FIELDS)}")
    for field in FIELDS:
        if field not in entry:
            raise UserError(f"{path}: camera '{name}' has no field '{field}'")
    try:
        numbers = {k: float(entry[k]) for k in FIELDS[:-1]}
        T = np.asarray(entry["world_to_camera"], np.float64)
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: camera '{name}' has a field of the wrong type ({error})") from None
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise UserError(f"{path}: camera '{name}': world_to_camera must be one finite 4x4 matrix")
    finite = all(np.isfinite(v) for v in numbers.values())
    if not finite or min(numbers["width"], numbers["height"]) < 1 or not min(numbers["fx"], numbers["fy"]) > 0:
        raise UserError(f"{path}: camera '{name}': width, height, fx and fy must be positive and cx, cy finite")
    width, height = int(numbers.pop("width")), int(numbers.pop("height"))
    return Camera(width, height, **numbers, T_camera_world=T)
