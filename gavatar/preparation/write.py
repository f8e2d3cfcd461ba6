"""Writing what was prepared as a gavatar capture, whole or not at all."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.progress import shown
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

from ..body.skeleton import BodyData
from ..capture.capture import CAPTURE_VERSION
from ..storage import write_image, write_json, write_motion
from .draw import body_mask, contact_sheet, iou, overlay
from .footage_source import Source

PREVIEW_SIDE = 512  # pixels of the longer side of one camera's picture in the preview
HELD_OUT_EVERY, HELD_OUT_FIRST = 10, 5  # frames 5, 15, 25, ... are for testing


@dataclasses.dataclass(frozen=True)
class CaptureFacts:
    """What capture.json says beside the numbers. holdout_camera: kept for novel views, or None. resting: joints whose
    rotation no frame shows."""

    name: str
    body_model: str
    license: str = "unknown"
    source: str = ""
    holdout_camera: str | None = None
    gender: str = "neutral"
    resting: tuple[str, ...] = ()


@contextlib.contextmanager
def new_folder(path: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place when the block ends, or vanishes when it fails.

    Raises UserError when `path` exists and may not be replaced: without `overwrite`, or when it holds no capture.
    """
    if path.exists() or path.is_symlink():
        if not overwrite:
            raise UserError(f"{path} exists: choose another folder, or let it be replaced with `overwrite`")
        if not path.is_dir() or (any(path.iterdir()) and not (path / "capture.json").is_file()):
            raise UserError(f"{path} is no capture (no capture.json in it), so `overwrite` will not delete it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror or error}") from error
    try:
        work = temporary / "new"  # not the private folder itself: this one has the user's usual permissions
        work.mkdir()
        yield work
        if path.exists():
            os.replace(path, temporary / "old")
        os.replace(work, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def make_splits(cameras: list[str], frames: int, holdout_camera: str | None) -> dict[str, list]:
    """Train and test views: every 10th frame of the training cameras is held out, a held-out camera wholly."""
    test = list(range(HELD_OUT_FIRST, frames, HELD_OUT_EVERY))
    train = [t for t in range(frames) if t not in set(test)]
    kept = [c for c in cameras if c != holdout_camera]
    splits = {"train": [[c, train] for c in kept]}
    if test:
        splits["test"] = [[c, test] for c in kept]
    if holdout_camera is not None:
        splits["novel_view"] = [[holdout_camera, list(range(frames))]]
    return splits


def write_capture(
    out: Path,
    source: Source,
    cameras: list[list[Camera]],
    data: BodyData,
    motion: Motion,
    facts: CaptureFacts,
    overwrite: bool = False,
    preview: bool = True,
    progress: bool = True,
) -> np.ndarray:
    """Write the capture; images are read, undistorted and written one by one. cameras: of each, one for all frames or
    one a frame.

    Returns the intersection over union (C, T) of the drawn body and the mask. Nothing is left at `out` on failure.
    """
    with new_folder(out, overwrite) as folder:
        scores = np.zeros((len(cameras), len(motion)))
        names = [footage.name for footage in source.footage]
        with _Preview(folder, motion.fps, len(motion), len(cameras), preview) as drawn:
            streams = [zip(f.images(), f.masks(), strict=True) for f in source.footage]
            views = zip(*streams, strict=True)
            for t, pairs in enumerate(shown(views, "write", "frame", total=len(motion), show=progress)):
                tiles = []
                for c, (image, mask) in enumerate(pairs):
                    _write_view(folder, names[c], t, image, mask, lossless=isinstance(source.footage[c].frames, list))
                    camera = cameras[c][t % len(cameras[c])]
                    score, tile = _draw(data, camera, motion, t, image, mask, preview)
                    scores[c, t] = score
                    tiles.append(tile)
                drawn.add(t, tiles)
        for footage in source.footage:
            if footage.background is not None:
                (folder / "backgrounds").mkdir(exist_ok=True)
                write_image(folder / "backgrounds" / f"{footage.name}.png", footage.background[..., ::-1] / 255.0)
        entries = {name: _camera_entry(path) for name, path in zip(names, cameras, strict=True)}
        write_json(folder / "cameras.json", entries)
        write_motion(folder / "body.npz", motion)
        info = {
            "version": CAPTURE_VERSION, "name": facts.name, "license": facts.license, "source": facts.source,
            "fps": motion.fps, "body_model": facts.body_model, "gender": facts.gender, "background": "footage",
            "units": "metres, radians", "world": "y-up",
            "splits": make_splits(names, len(motion), facts.holdout_camera),
        }  # fmt: skip
        if facts.resting:
            info["resting"] = list(facts.resting)
        write_json(folder / "capture.json", info)
    return scores


def _camera_entry(path: list[Camera]) -> dict:
    """A camera; of one that moves the middle frame's, and under `per_frame` what differs from frame to frame."""
    camera = path[len(path) // 2]
    entry = {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
    entry["world_to_camera"] = camera.T_camera_world.tolist()
    if len(path) > 1:
        moving = {key: [getattr(c, key) for c in path] for key in ("fx", "fy", "cx", "cy")}
        entry["per_frame"] = moving | {"world_to_camera": [c.T_camera_world.tolist() for c in path]}
    return entry


def _write_view(folder: Path, camera: str, t: int, image: np.ndarray, mask: np.ndarray, lossless: bool) -> None:
    """PNG for footage that came as images, JPEG for what a video codec has been through already."""
    for kind in ("images", "masks"):
        (folder / kind / camera).mkdir(parents=True, exist_ok=True)
    path = folder / "images" / camera / f"{t:06d}{'.png' if lossless else '.jpg'}"
    options = [] if lossless else [cv2.IMWRITE_JPEG_QUALITY, 95]
    if not cv2.imwrite(str(path), image, options) or not cv2.imwrite(
        str(folder / "masks" / camera / f"{t:06d}.png"), mask
    ):
        raise UserError(f"{path} could not be written: is the disk full?")


def _draw(
    data: BodyData, camera: Camera, motion: Motion, t: int, image: np.ndarray, mask: np.ndarray, preview: bool
) -> tuple[float, np.ndarray | None]:
    scale = min(1.0, PREVIEW_SIDE / max(camera.width, camera.height))
    small = camera.scaled(scale)
    size = (small.width, small.height)
    body = motion.poses[t], motion.betas, motion.trans[t]
    person = cv2.resize(mask, size, interpolation=cv2.INTER_AREA) > 127
    score = iou(body_mask(data, small, *body) > 0, person)
    if not preview:
        return score, None
    tile = overlay(cv2.resize(image, size, interpolation=cv2.INTER_AREA), data, small, *body)
    outline, _ = cv2.findContours(person.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(tile, outline, -1, (0, 220, 0), 1)
    cv2.putText(tile, f"{t}  IoU {score:.2f}", (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (0, 0, 255), 1, cv2.LINE_AA)
    return score, tile


class _Preview:
    """preview.mp4 with every frame and preview.png with a sample of them, cameras side by side."""

    def __init__(self, folder: Path, fps: float, frames: int, cameras: int, wanted: bool):
        self.folder, self.fps, self.wanted = folder, fps, wanted
        self.sampled = set(evenly_spaced(frames, max(1, 54 // cameras)).tolist())
        self.columns = max(1, 9 // cameras)
        self.sheet: list[np.ndarray] = []
        self.video: cv2.VideoWriter | None = None

    def __enter__(self) -> _Preview:
        return self

    def add(self, t: int, tiles: list[np.ndarray | None]) -> None:
        if not self.wanted:
            return
        given = [tile for tile in tiles if tile is not None]
        height = max(tile.shape[0] for tile in given)
        picture = np.hstack([cv2.copyMakeBorder(i, 0, height - i.shape[0], 0, 0, cv2.BORDER_CONSTANT) for i in given])
        if t in self.sampled:
            self.sheet.append(picture)
        # video codecs want even sides
        even = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
        if self.video is None and even.size:
            code = cv2.VideoWriter.fourcc(*"mp4v")
            self.video = cv2.VideoWriter(str(self.folder / "preview.mp4"), code, self.fps, even.shape[1::-1])
        if self.video is not None:
            self.video.write(np.ascontiguousarray(even))

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:
        if self.video is not None:
            self.video.release()
        if kind is None and self.sheet:
            width = round(self.sheet[0].shape[1] * min(1.0, 2160 / self.columns / self.sheet[0].shape[1]))
            sheet = contact_sheet(self.sheet, self.columns, max(width, 1))
            write_image(self.folder / "preview.png", sheet[..., ::-1] / 255.0)
