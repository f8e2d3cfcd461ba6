"""What was filmed: images, masks, cameras, body motion, splits.

On disk (format version 1)::

    capture.json     version, name, license, source, fps, body_model, background, splits; resting optional
    cameras.json     per camera: width, height, fx, fy, cx, cy, world_to_camera (4x4); of one that moves
                     also `per_frame`: fx, fy, cx, cy, world_to_camera of each frame
    images/CAM/%06d.png|jpg     masks/CAM/%06d.png (8-bit alpha)     backgrounds/CAM.png optional: nobody in the room
    body.npz         AMASS keys: poses (T, 3J), trans, betas, mocap_framerate, gender; expression (T, E) optional
    body_truth.npz   optional ground truth, read by evaluation only

Frame numbers index the rows of body.npz.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gavatar_runtime.errors import Faults, UserError, cannot_read, frames_named
from gavatar_runtime.formats.camera_file import read_cameras
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

from ..images.unmixing import without_background
from .moving_cameras import read_moving
from .placement import Placement

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
    image_path, mask_path: functions of a View. read_mask: from a mask's path to (H, W) uint8 alpha, where masks are not
    images of alpha. moving: the cameras of views whose camera moves, over those of `cameras`. lenses: distortion
    coefficients (OpenCV's k1, k2, p1, p2, k3) by camera: images are straightened when loaded. listing: the file that
    names the views. placement: how the motion is brought to a body, None when it needs no bringing. gender: of
    the body model, 'neutral' if nothing says. resting: joints that no image shows and whose pose is a guess. rooms:
    (H, W, 3) float32 RGB in [0, 1] by camera, what stands behind the person, of those cameras of which it is known.
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
    read_mask: Callable[[Path], np.ndarray] | None = None
    moving: dict[View, Camera] = dataclasses.field(default_factory=dict)
    lenses: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    listing: str = "capture.json"
    placement: Placement | None = None
    gender: str = "neutral"
    resting: tuple[str, ...] = ()
    rooms: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def camera(self, view: View) -> Camera:
        """The camera of one view."""
        return self.moving.get(view) or self.cameras[view.camera]

    def placed(self, body: BodyData) -> Capture:
        """The capture with its motion as `body` takes it: captures of others give translations that depend on the rest
        pelvis of the body that they were made with, and shapes that mean something to that body alone."""
        if self.placement is None:
            return self
        return dataclasses.replace(self, motion=self.placement.motion(body))

    def views(self, split: str) -> list[View]:
        """The views of a split; UserError when the capture has no such split."""
        if not self.splits.get(split):
            have = ", ".join(k for k, v in self.splits.items() if v)
            raise UserError(f"{self.path / self.listing}: no split '{split}' (it has: {have})")
        return self.splits[split]

    def load(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) float32 premultiplied colour (colour x alpha) and (H, W) float32 alpha, both in [0, 1].

        Composite over any background b as `color + (1 - alpha) b`. Raises UserError for a missing or unreadable file
        and for an image or mask whose size is not the camera's.
        """
        image, mask = self.read(view)
        image, alpha = image[..., ::-1].astype(np.float32) / 255, mask.astype(np.float32) / 255
        if self.background == "white":
            return np.clip(image - (1 - alpha[..., None]), 0, 1), alpha
        room = self.rooms.get(view.camera)
        if room is not None and room.shape == image.shape:
            return without_background(image, alpha, room), alpha
        return image * alpha[..., None], alpha

    def resized(self, scale: float) -> Capture:
        """The same capture with every image area-averaged (enlarged: interpolated) by `scale`, cameras alike."""
        cameras = {name: camera.scaled(scale) for name, camera in self.cameras.items()}
        moving = {view: camera.scaled(scale) for view, camera in self.moving.items()}
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(Capture)}
        return _Resized(**(fields | {"cameras": cameras, "moving": moving}), original=self)

    def read(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) uint8 BGR and (H, W) uint8 alpha as they lie on disk, straightened; UserError as `load` raises."""
        camera = self.camera(view)
        image = read_image(self.image_path(view), cv2.IMREAD_COLOR)
        _check_size(self.image_path(view), image, camera)
        mask_path = self.mask_path(view)
        mask = (self.read_mask or read_gray)(mask_path)
        _check_size(mask_path, mask, camera)
        lens = self.lenses.get(view.camera)
        if lens is None or not np.any(lens):
            return image, mask
        # OpenCV counts from pixel centres, gavatar from the image's corner
        K = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
        return cv2.undistort(image, K, lens), cv2.undistort(mask, K, lens)

    def missing(self) -> dict[Path, str]:
        """A sentence for every image and mask that the splits name and that is not there, by the path."""
        faults = {}
        for views in self.splits.values():
            for view in views:
                for path in (self.image_path(view), self.mask_path(view)):
                    if path not in faults and not path.is_file():
                        faults[path] = f"{path} is missing, though {self.path / self.listing} lists frame {view}"
        return faults

    def check(self) -> None:
        """Every image and mask the splits name exists, before any work starts; UserError names the first fault."""
        for fault in self.missing().values():
            raise UserError(fault)


@dataclasses.dataclass(kw_only=True)
class _Resized(Capture):
    original: Capture

    def load(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        return self._sized(view, self.original.load(view))

    def read(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        return self._sized(view, self.original.read(view))

    def _sized(self, view: View, images: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        camera = self.camera(view)
        mode = cv2.INTER_AREA if camera.width < images[0].shape[1] else cv2.INTER_LINEAR
        color, alpha = (cv2.resize(image, (camera.width, camera.height), interpolation=mode) for image in images)
        return color, alpha


def read_image(path: Path, flag: int) -> np.ndarray:
    """The pixels of an image file as OpenCV reads them; UserError when it is missing or damaged."""
    if not path.is_file():
        raise UserError(f"{path} is missing")
    image = cv2.imread(str(path), flag)
    if image is None:
        raise UserError(f"{path} cannot be read as an image: it is damaged or of an unknown format")
    return image


def _rooms(folder: Path, cameras: list[str]) -> dict[str, np.ndarray]:
    files = {name: folder / f"{name}.png" for name in cameras}
    return {name: read_image(path, cv2.IMREAD_COLOR)[..., ::-1].astype(np.float32) / 255
            for name, path in files.items() if path.is_file()}  # fmt: skip


def read_gray(path: Path) -> np.ndarray:
    """(H, W) uint8."""
    return read_image(path, cv2.IMREAD_GRAYSCALE)


def _check_size(path: Path, image: np.ndarray, camera: Camera) -> None:
    if image.shape[:2] != (camera.height, camera.width):
        raise UserError(
            f"{path} is {image.shape[1]}x{image.shape[0]} pixels, but its camera is {camera.width}x{camera.height}"
        )


def _json(path: Path) -> dict:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{path} is missing: a gavatar capture needs it") from None
    except OSError as error:
        raise cannot_read(path, error) from None
    except (ValueError, RecursionError) as error:  # of JSON, of its encoding, of numbers of too many digits
        raise UserError(f"{path} is not valid JSON: {error}") from None
    if not isinstance(value, dict):
        raise UserError(f"{path} must hold a JSON object")
    return value


def _whole_number(value: float | str) -> int:
    number = int(value)
    if isinstance(value, float) and number != value:
        raise ValueError(f"{value} is no whole number")
    return number


def _splits(
    path: Path, entries: dict, cameras: dict[str, Camera], frames: int, faults: Faults
) -> dict[str, list[View]]:
    splits: dict[str, list[View]] = {}
    for split, groups in entries.items():
        views = []
        try:
            for camera, numbers in groups:
                views += [View(str(camera), _whole_number(n)) for n in numbers]
        except (TypeError, ValueError, OverflowError):
            faults.add(f"{path}: split '{split}' must be a list of [camera, [frame, ...]], frames whole numbers")
        unknown = [view.camera for view in views if view.camera not in cameras]
        faults.add_all(
            (f"{path}: split '{split}' names camera '{camera}', which cameras.json lacks" for camera in unknown),
            f"cameras of split '{split}'",
        )
        outside = {view.frame for view in views if not 0 <= view.frame < frames}
        if outside:
            faults.add(f"{path}: split '{split}' names {frames_named(outside)}, but body.npz has {frames} frames")
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


def _capture_json(path: Path) -> dict:
    info, faults = _json(path / "capture.json"), Faults(collect=True)
    version = info.get("version")
    if isinstance(version, int) and version > CAPTURE_VERSION:
        raise UserError(
            f"{path / 'capture.json'} is of format version {version}; this gavatar reads {CAPTURE_VERSION}: upgrade it"
        )
    if version != CAPTURE_VERSION:
        faults.add(f"{path / 'capture.json'}: version must be {CAPTURE_VERSION}, not {version!r}")
    background = info.get("background")
    if background and background not in ("white", "footage"):
        faults.add(f"{path / 'capture.json'}: background must be 'white' or 'footage', not {background!r}")
    if not isinstance(info.get("resting") or [], list):
        faults.add(f"{path / 'capture.json'}: resting must be a list of names of joints")
    if not isinstance(info.get("splits") or {}, dict):
        faults.add(f"{path / 'capture.json'}: splits must be an object of views by split")
    faults.stop()
    return info


def _truth(path: Path, motion: Motion | None) -> Motion | None:
    if not (path / "body_truth.npz").exists():
        return None
    truth = read_motion(path / "body_truth.npz", up="y")
    if motion is not None and len(truth) != len(motion):
        raise UserError(f"{path / 'body_truth.npz'} has {len(truth)} frames, but body.npz has {len(motion)}")
    return truth


def read_capture(path: str | os.PathLike, faults: Faults | None = None) -> Capture:
    """Open a capture in gavatar's own layout. Raises UserError, naming file and field, for anything malformed; with
    `faults` every one that can be told is collected first."""
    path, faults = Path(path), faults or Faults()
    if not path.is_dir():
        raise UserError(f"{path} is not a directory: give the folder of a capture (it holds capture.json)")
    info = faults.of(_capture_json, path)
    cameras = faults.of(read_cameras, path / "cameras.json", faults.add)
    motion = faults.of(read_motion, path / "body.npz", up="y")
    truth = faults.of(_truth, path, motion)
    splits: Any = None
    moving: dict[str, list[Camera]] = {}
    if info is not None and cameras is not None and motion is not None:
        moving = faults.of(read_moving, path / "cameras.json", cameras, len(motion)) or {}
        splits = faults.of(_splits, path / "capture.json", info.get("splits") or {}, cameras, len(motion), faults)
    faults.stop()

    def image_path(view: View) -> Path:
        stem = path / "images" / view.camera / f"{view.frame:06d}"
        jpg = stem.with_suffix(".jpg")
        return jpg if jpg.is_file() else stem.with_suffix(".png")

    def mask_path(view: View) -> Path:
        return path / "masks" / view.camera / f"{view.frame:06d}.png"

    first = splits["train"][0]
    background = info.get("background") or _background(first, image_path(first), mask_path(first))
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
        gender=str(info.get("gender", "neutral")),
        resting=tuple(map(str, info.get("resting") or ())),
        moving={view: moving[view.camera][view.frame] for view in chain(*splits.values()) if view.camera in moving},
        rooms=_rooms(path / "backgrounds", list(cameras)),
    )
