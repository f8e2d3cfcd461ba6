"""What was filmed: images, masks, cameras, body motion, splits.

On disk (format version 1)::

    capture.json     version, name, license, source, fps, body_model, background, splits
    cameras.json     per camera: width, height, fx, fy, cx, cy, world_to_camera (4x4)
    images/CAM/%06d.png|jpg     masks/CAM/%06d.png (8-bit alpha)
    body.npz         AMASS keys: poses (T, 3J), trans, betas, mocap_framerate, gender
    body_truth.npz   optional ground truth, read by evaluation only

Frame numbers index the rows of body.npz.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.camera import Camera
from gavatar_runtime.camera_file import read_cameras
from gavatar_runtime.errors import UserError
from gavatar_runtime.motion import Motion
from gavatar_runtime.motions import read_motion

CAPTURE_VERSION = 1
SPLITS = ("train", "val", "test", "novel_pose", "novel_view")


@dataclasses.dataclass(frozen=True)
class View:
    """One image of a capture: which camera saw which frame."""

    camera: str
    frame: int

    def __str__(self) -> str:
        return f"{self.camera}/{self.frame:06d}"


@dataclasses.dataclass
class Capture:
    """A capture opened for reading; images are read when asked for.

    path: its directory. motion: estimated body motion, one row a frame. truth: exact motion or None, never used by
    training. cameras: by name. splits: views by split name. background: 'white' when the images are the person
    composited on white, 'footage' when they show the scene.
    image_path, mask_path: functions of a View.
    """

    path: Path
    name: str
    license: str
    source: str
    body_model: str
    background: str
    cameras: dict[str, Camera]
    splits: dict[str, list[View]]
    motion: Motion
    truth: Motion | None
    image_path: Callable[[View], Path]
    mask_path: Callable[[View], Path]

    def views(self, split: str) -> list[View]:
        """The views of a split; UserError when the capture has no such split."""
        if not self.splits.get(split):
            have = ", ".join(k for k, v in self.splits.items() if v)
            raise UserError(f"{self.path / 'capture.json'}: no split '{split}' (it has: {have})")
        return self.splits[split]

    def load(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) float32 premultiplied colour (colour x alpha) and (H, W) float32 alpha, both in [0, 1].

        Composite over any background b as `color + (1 - alpha) b`. Raises UserError for a missing or unreadable file
        and for an image or mask whose size is not the camera's.
        """
        camera = self.cameras[view.camera]
        image = _read(self.image_path(view), cv2.IMREAD_COLOR, camera)[..., ::-1].astype(np.float32) / 255
        alpha = _read(self.mask_path(view), cv2.IMREAD_GRAYSCALE, camera).astype(np.float32) / 255
        if self.background == "white":
            return np.clip(image - (1 - alpha[..., None]), 0, 1), alpha
        return image * alpha[..., None], alpha

    def resized(self, scale: float) -> Capture:
        """The same capture with every image area-averaged (enlarged: interpolated) by `scale`, cameras alike."""
        cameras = {name: camera.scaled(scale) for name, camera in self.cameras.items()}
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(Capture)}
        return _Resized(**(fields | {"cameras": cameras}), original=self)

    def check(self) -> None:
        """Every image and mask the splits name exists, before any work starts; UserError names the first fault."""
        for views in self.splits.values():
            for view in views:
                for path in (self.image_path(view), self.mask_path(view)):
                    if not path.is_file():
                        raise UserError(f"{path} is missing, though {self.path / 'capture.json'} lists frame {view}")


@dataclasses.dataclass
class _Resized(Capture):
    original: Capture

    def load(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        camera = self.cameras[view.camera]
        color, alpha = self.original.load(view)
        mode = cv2.INTER_AREA if camera.width < color.shape[1] else cv2.INTER_LINEAR
        return tuple(cv2.resize(image, (camera.width, camera.height), interpolation=mode) for image in (color, alpha))


def _read(path: Path, flag: int, camera: Camera) -> np.ndarray:
    if not path.is_file():
        raise UserError(f"{path} is missing")
    image = cv2.imread(str(path), flag)
    if image is None:
        raise UserError(f"{path} cannot be read as an image: it is damaged or of an unknown format")
    if image.shape[:2] != (camera.height, camera.width):
        raise UserError(
            f"{path} is {image.shape[1]}x{image.shape[0]} pixels, but its camera in cameras.json is "
            f"{camera.width}x{camera.height}"
        )
    return image


def _json(path: Path) -> dict:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{path} is missing: a gavatar capture needs it") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not valid JSON: {error}") from None
    if not isinstance(value, dict):
        raise UserError(f"{path} must hold a JSON object")
    return value


def _splits(path: Path, entries: dict, cameras: dict[str, Camera], frames: int) -> dict[str, list[View]]:
    splits: dict[str, list[View]] = {}
    for split, groups in entries.items():
        views = []
        try:
            for camera, numbers in groups:
                views += [View(str(camera), int(n)) for n in numbers]
        except (TypeError, ValueError):
            raise UserError(f"{path}: split '{split}' must be a list of [camera, [frame, ...]]") from None
        for view in views:
            if view.camera not in cameras:
                raise UserError(f"{path}: split '{split}' names camera '{view.camera}', which cameras.json lacks")
            if not 0 <= view.frame < frames:
                raise UserError(f"{path}: split '{split}' names frame {view.frame}, but body.npz has {frames} frames")
        splits[split] = views
    if not splits.get("train"):
        raise UserError(f"{path}: split 'train' is missing or empty")
    return splits


def _background(first: View, image: Path, mask: Path) -> str:
    """Captures written before the `background` field: white when every pixel outside the first mask is white."""
    pixels, alpha = cv2.imread(str(image)), cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE)
    if pixels is None or alpha is None or pixels.shape[:2] != alpha.shape or not (alpha == 0).any():
        return "footage"
    return "white" if np.percentile(pixels[alpha == 0], 1) >= 250 else "footage"


def read_capture(path: str | os.PathLike) -> Capture:
    """Open a capture in gavatar's own layout. Raises UserError, naming file and field, for anything malformed."""
    path = Path(path)
    if not path.is_dir():
        raise UserError(f"{path} is not a directory: give the folder of a capture (it holds capture.json)")
    info = _json(path / "capture.json")
    version = info.get("version")
    if version != CAPTURE_VERSION:
        if isinstance(version, int) and version > CAPTURE_VERSION:
            raise UserError(
                f"{path / 'capture.json'} is of format version {version}; this gavatar reads {CAPTURE_VERSION}: "
                "upgrade it"
            )
        raise UserError(f"{path / 'capture.json'}: version must be {CAPTURE_VERSION}, not {version!r}")
    cameras = read_cameras(path / "cameras.json")
    motion = read_motion(path / "body.npz", up="y")
    truth = read_motion(path / "body_truth.npz", up="y") if (path / "body_truth.npz").exists() else None
    if truth is not None and len(truth) != len(motion):
        raise UserError(f"{path / 'body_truth.npz'} has {len(truth)} frames, but body.npz has {len(motion)}")
    splits = _splits(path / "capture.json", info.get("splits") or {}, cameras, len(motion))

    def image_path(view: View) -> Path:
        stem = path / "images" / view.camera / f"{view.frame:06d}"
        jpg = stem.with_suffix(".jpg")
        return jpg if jpg.is_file() else stem.with_suffix(".png")

    def mask_path(view: View) -> Path:
        return path / "masks" / view.camera / f"{view.frame:06d}.png"

    first = splits["train"][0]
    background = info.get("background") or _background(first, image_path(first), mask_path(first))
    if background not in ("white", "footage"):
        raise UserError(f"{path / 'capture.json'}: background must be 'white' or 'footage', not {background!r}")
    return Capture(
        path=path,
        name=str(info.get("name", path.name)),
        license=str(info.get("license", "unknown")),
        source=str(info.get("source", "")),
        body_model=str(info.get("body_model", "smplh")),
        background=background,
        cameras=cameras,
        splits=splits,
        motion=motion,
        truth=truth,
        image_path=image_path,
        mask_path=mask_path,
    )
