"""What a capture holds, in one short word: the same footage at another place is the same, changed footage is not."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from .capture import Capture, View


def fingerprint(capture: Capture, split: str) -> str:
    """16 hexadecimal digits of what training on a split reads: its views, their cameras, lenses and empty rooms, the
    motion, and the sizes of the files of images and masks (not their pixels, which would take as long to read as
    training does)."""
    digest = hashlib.sha256()
    for part in _parts(capture, capture.views(split)):
        digest.update(part)
    return digest.hexdigest()[:16]


def _parts(capture: Capture, views: list[View]) -> Iterator[bytes]:
    motion = capture.motion
    yield _plain([capture.body_model, capture.gender, capture.background, motion.fps])
    for array in (motion.poses, motion.trans, motion.betas, motion.expression):
        yield _plain(None if array is None else list(array.shape))
        yield b"" if array is None else np.ascontiguousarray(array).tobytes()
    for name in sorted({view.camera for view in views} & set(capture.rooms)):  # their colours are taken out on loading
        yield _plain([name, list(capture.rooms[name].shape)])
        yield np.ascontiguousarray(capture.rooms[name]).tobytes()
    for view in views:
        camera = capture.camera(view)
        lens = capture.lenses.get(view.camera)
        yield _plain([str(view), camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy])
        yield _plain([np.asarray(camera.T_camera_world).tolist(), None if lens is None else np.asarray(lens).tolist()])
        files = (capture.image_path(view), capture.mask_path(view))
        yield _plain([file.stat().st_size if file.is_file() else None for file in files])


def _plain(value: Any) -> bytes:
    return json.dumps(value, default=float).encode()
