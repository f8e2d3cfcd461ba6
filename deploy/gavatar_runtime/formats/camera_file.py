"""Cameras on disk: the cameras.json of a capture, or one camera by itself."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Faults, MissingFile, UserError, WrongValue, cannot_read, did_you_mean
from ..values.camera import Camera

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
        raise MissingFile(f"camera file {path} does not exist") from None
    except OSError as error:
        raise cannot_read(f"camera file {path}", error) from None
    except (ValueError, RecursionError) as error:  # of JSON, of its encoding, of numbers of too many digits
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
            for sentence in error.sentences:
                fault(sentence)
    return cameras


def read_camera(source: str) -> Camera:
    """The camera `FILE.json:NAME`, or the only or first one of `FILE.json`."""
    match = re.fullmatch(r"(.+?\.json)(?::(.+))?", source, re.IGNORECASE)
    if match is None:
        raise WrongValue(f"camera '{source}' is not of the form FILE.json or FILE.json:NAME")
    path, name = match.groups()
    cameras = read_cameras(path)
    if name is None:
        return next(iter(cameras.values()))
    if name not in cameras:
        raise WrongValue(f"{path} has no camera '{name}': {did_you_mean(name, cameras)}")
    return cameras[name]


def _camera(path: Path, name: str, entry: object) -> Camera:
    if not isinstance(entry, dict):
        raise UserError(f"{path}: camera '{name}' must be an object with the fields {', '.join(FIELDS)}")
    missing = [f"{path}: camera '{name}' has no field '{field}'" for field in FIELDS if field not in entry]
    if missing:
        raise UserError(*missing)
    faults = Faults(collect=True)
    values = {field: faults.of(_number, path, name, field, entry[field]) for field in FIELDS[:-1]}
    try:
        T = np.asarray(entry["world_to_camera"], np.float64)
    except (TypeError, ValueError, OverflowError):
        T = np.zeros(0)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        faults.add(f"{path}: camera '{name}': world_to_camera must be one finite 4x4 matrix")
    faults.stop()
    width, height = int(values.pop("width")), int(values.pop("height"))
    return Camera(width, height, **values, T_camera_world=T)


def _number(path: Path, name: str, field: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise UserError(f"{path}: camera '{name}': {field} is of the wrong type, expected a number") from None
    least = {"width": 1, "height": 1, "fx": 1e-12, "fy": 1e-12}.get(field, -np.inf)
    if not (np.isfinite(number) and number >= least):
        kind = "positive" if field in ("width", "height", "fx", "fy") else "finite"
        raise UserError(f"{path}: camera '{name}': {field} must be {kind}, not {number:g}")
    return number
