"""Reading footage with landmarks and masks beside it, the lens' distortion removed.

Two layouts are recognised::

    frames/*.png|jpg (or one video)   masks/NAME.png   landmarks.npz                           one camera, unknown
    videos/CAM.mp4 (or frames/CAM/)   masks/CAM/NAME.png   landmarks_CAM.npz   cameras.json    calibrated cameras

A mask has the name of its frame, or its number as 000000.png when the frames come from a video.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from gavatar_runtime.camera import Camera
from gavatar_runtime.errors import UserError

from .landmarks import Landmarks, read_landmarks

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")
RAW_VIDEO = "finding masks and landmarks in raw video is not part of gavatar-prepare yet"


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


@dataclasses.dataclass(frozen=True)
class Footage:
    """One camera's footage, frames chosen, brought to the size and lens of the capture as it is read.

    name: the camera's. frames: image files or one video. numbers: (T,) which frames of the source. mask_files: T files.
    filmed_size, size: (width, height) of the source and of the capture. lens: None when the camera is unknown.
    landmarks: of the chosen frames, in the capture's undistorted pixels.
    """

    name: str
    frames: list[Path] | Path
    numbers: np.ndarray
    mask_files: list[Path]
    filmed_size: tuple[int, int]
    size: tuple[int, int]
    lens: Lens | None
    landmarks: Landmarks

    @property
    def camera(self) -> Camera | None:
        """The pinhole camera of the prepared images, or None when unknown."""
        return None if self.lens is None else self.lens.camera.resized(*self.size)

    def images(self) -> Iterator[np.ndarray]:
        """(H, W, 3) uint8 BGR of each chosen frame, undistorted and resized. UserError for an unreadable frame."""
        raw = _video_frames(self.frames, self.numbers) if isinstance(self.frames, Path) else map(_image, self.frames)
        for number, image in zip(self.numbers, raw, strict=True):
            yield self._prepared(image, self.frames if isinstance(self.frames, Path) else self.frames[0].parent, number)

    def masks(self) -> Iterator[np.ndarray]:
        """(H, W) uint8 alpha of each chosen frame, undistorted and resized. UserError for a mask of another size."""
        for number, path in zip(self.numbers, self.mask_files, strict=True):
            yield self._prepared(_image(path, cv2.IMREAD_GRAYSCALE), path, number)

    def _prepared(self, image: np.ndarray, path: Path, number: int) -> np.ndarray:
        if (image.shape[1], image.shape[0]) != self.filmed_size:
            raise UserError(
                f"{path} (frame {number}) is {image.shape[1]}x{image.shape[0]} pixels, but camera '{self.name}' "
                f"filmed {self.filmed_size[0]}x{self.filmed_size[1]}"
            )
        if self.lens is not None:
            image = self.lens.undistort_image(image)
        if self.size != self.filmed_size:
            smaller = self.size[0] < self.filmed_size[0]
            image = cv2.resize(image, self.size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_CUBIC)
        return image


@dataclasses.dataclass(frozen=True)
class Source:
    """Footage of every camera, frame by frame at the same times. fps: of the chosen frames. description: what was
    found, for the user."""

    footage: list[Footage]
    fps: float
    description: str


@dataclasses.dataclass(frozen=True)
class SourceOptions:
    """Where things are when not in their usual place, and what to take: see `gavatar-prepare --help`."""

    landmarks: Path | None = None
    masks: Path | None = None
    cameras: Path | None = None
    fps: float | None = None
    frames: slice = dataclasses.field(default_factory=slice)
    size: int | None = None


def open_source(path: Path, options: SourceOptions | None = None) -> Source:
    """Recognise the layout of `path` (a folder, or a video with --landmarks and --masks) and check it whole.

    Raises UserError, naming the file and the fix, for whatever is missing or does not fit together.
    """
    options = options or SourceOptions()
    if not path.exists():
        raise UserError(f"{path} does not exist: give a folder of footage or a video")
    if path.is_file():
        if path.suffix.lower() not in VIDEO_SUFFIXES:
            raise UserError(f"{path} is no video ({', '.join(VIDEO_SUFFIXES)}): give a folder of footage or a video")
        if options.landmarks is None or options.masks is None:
            raise UserError(f"{path}: {RAW_VIDEO}; give them with --landmarks FILE and --masks DIR")
        folder, found = path.parent, {"cam0": path}
    else:
        folder, found = path, _cameras_of(path)
    cameras_file = options.cameras or (folder / "cameras.json" if (folder / "cameras.json").is_file() else None)
    lenses = read_lenses(cameras_file) if cameras_file else {}
    if not lenses and len(found) > 1:
        raise UserError(f"{path} holds {len(found)} cameras ({', '.join(found)}) but no cameras.json: give --cameras")
    footage, rates = [], []
    for name, frames in found.items():
        if lenses and name not in lenses:
            raise UserError(f"{cameras_file} has no camera '{name}', which {path} holds (it has: {', '.join(lenses)})")
        one, rate = _footage(folder, name, frames, lenses.get(name), options, alone=len(found) == 1)
        footage.append(one)
        rates.append(rate)
    if len({len(f.numbers) for f in footage}) > 1:
        counts = ", ".join(f"{f.name} {len(f.numbers)}" for f in footage)
        raise UserError(
            f"{path}: the cameras have different numbers of frames ({counts}); choose common ones: --frames"
        )
    known = [rate for rate in rates if rate]
    fps = options.fps or (known[0] if known else None)
    if fps is None:
        raise UserError(f"{path}: neither landmarks nor video say the frame rate: give --fps")
    kind = "video" if isinstance(next(iter(found.values())), Path) else "image"
    description = (
        f"{len(footage)} camera{'s' * (len(footage) > 1)} ({', '.join(found)}), {len(footage[0].numbers)} frames from "
        f"{kind} files at {fps:.4g} fps, {'calibrated' if lenses else 'camera unknown'}, with landmarks and masks"
    )
    return Source(footage, fps / abs(options.frames.step or 1), description)


def _cameras_of(folder: Path) -> dict[str, list[Path] | Path]:
    """Image files or a video of every camera in a folder."""
    for base in (folder / "videos", folder / "frames"):
        if not base.is_dir():
            continue
        videos = [p for p in sorted(base.iterdir()) if p.suffix.lower() in VIDEO_SUFFIXES]
        if videos:
            return {p.stem: p for p in videos}
        images = _image_files(base)
        if images:
            return {"cam0": images}
        cameras = {p.name: _image_files(p) for p in sorted(base.iterdir()) if p.is_dir()}
        cameras = {name: images for name, images in cameras.items() if images}
        if cameras:
            return cameras
    videos = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in VIDEO_SUFFIXES]
    if len(videos) == 1:
        return {"cam0": videos[0]}
    raise UserError(f"{folder} holds no footage: it needs frames/ with images, one video, or videos/CAM.mp4")


def _image_files(folder: Path) -> list[Path]:
    return [p for p in sorted(folder.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES]


def _footage(folder, name, frames, lens, options, alone) -> tuple[Footage, float | None]:
    if isinstance(frames, Path):
        count, rate, filmed = _video_facts(frames)
        stems = [f"{k:06d}" for k in range(count)]
    else:
        count, rate = len(frames), None
        stems = [p.stem for p in frames]
        filmed = _image(frames[0]).shape[1::-1]
    landmarks_file = _landmarks_file(folder, name, options, alone)
    landmarks = read_landmarks(landmarks_file)
    if len(landmarks) != count:
        raise UserError(f"{landmarks_file} has {len(landmarks)} frames, but the footage of '{name}' has {count}")
    if landmarks.width and landmarks.height and (landmarks.width, landmarks.height) != filmed:
        raise UserError(
            f"{landmarks_file} was made for {landmarks.width}x{landmarks.height} pixels, but the footage of '{name}' "
            f"is {filmed[0]}x{filmed[1]}"
        )
    if lens is not None and (lens.camera.width, lens.camera.height) != filmed:
        raise UserError(
            f"cameras.json: camera '{name}' is {lens.camera.width}x{lens.camera.height}, but its footage is "
            f"{filmed[0]}x{filmed[1]}"
        )
    numbers = np.arange(count)[options.frames]
    if not len(numbers):
        raise UserError(f"--frames leaves nothing of the {count} frames of '{name}': choose a range inside 0:{count}")
    masks = _mask_files(folder, name, [stems[k] for k in numbers], options, alone)
    scale = 1.0 if options.size is None else options.size / max(filmed)
    size = (max(1, round(filmed[0] * scale)), max(1, round(filmed[1] * scale)))
    chosen = landmarks[numbers]
    image = lens.undistort_points(chosen.image) if lens is not None and np.any(lens.distortion) else chosen.image
    chosen = dataclasses.replace(chosen, image=image * (np.array(size) / filmed), width=size[0], height=size[1])
    if not isinstance(frames, Path):
        frames = [frames[k] for k in numbers]
    return Footage(name, frames, numbers, masks, filmed, size, lens, chosen), landmarks.fps or rate


def _landmarks_file(folder: Path, name: str, options: SourceOptions, alone: bool) -> Path:
    given = options.landmarks
    if given is not None and given.is_file() and alone:
        return given
    base = folder if given is None else given
    choices = [base / f"landmarks_{name}.npz", base / f"{name}.npz"] + [base / "landmarks.npz"] * alone
    for path in choices:
        if path.is_file():
            return path
    raise UserError(f"{choices[-1] if alone else choices[0]} is missing: {RAW_VIDEO}; give --landmarks")


def _mask_files(folder: Path, name: str, stems: list[str], options: SourceOptions, alone: bool) -> list[Path]:
    base = options.masks or folder / "masks"
    base = base / name if (base / name).is_dir() else base
    if not base.is_dir() or not (alone or base.name == name):
        raise UserError(f"{base} is missing: {RAW_VIDEO}; give --masks DIR")
    files = [base / f"{stem}.png" for stem in stems]
    missing = [path for path in files if not path.is_file()]
    if missing:
        raise UserError(f"{missing[0]} is missing ({len(missing)} of {len(files)} masks): every frame needs its mask")
    return files


def _image(path: Path, flag: int = cv2.IMREAD_COLOR) -> np.ndarray:
    image = cv2.imread(str(path), flag)
    if image is None:
        raise UserError(f"{path} cannot be read as an image: it is damaged or of an unknown format")
    return image


def _video_facts(path: Path) -> tuple[int, float | None, tuple[int, int]]:
    video = cv2.VideoCapture(str(path))
    count, rate = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), video.get(cv2.CAP_PROP_FPS)
    size = int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT))
    opened = video.isOpened()
    video.release()
    if not opened or count < 1:
        raise UserError(f"{path} cannot be read as a video: it is damaged or its codec is unknown to OpenCV")
    return count, rate if rate and np.isfinite(rate) and rate > 0 else None, size


def _video_frames(path: Path, numbers: np.ndarray) -> Iterator[np.ndarray]:
    """Decoded in order from the start: seeking in compressed video is not exact. `numbers` must increase."""
    video = cv2.VideoCapture(str(path))
    try:
        wanted = iter(numbers)
        target = next(wanted)
        for k in range(int(numbers[-1]) + 1):
            ok, image = video.read()
            if not ok:
                raise UserError(f"{path} ends at frame {k}, but frame {numbers[-1]} was asked for: it is damaged")
            if k == target:
                yield image
                target = next(wanted, None)
    finally:
        video.release()


def read_lenses(path: Path) -> dict[str, Lens]:
    """Read cameras.json: width, height, fx, fy, cx, cy, world_to_camera (4x4) and, where the lens distorts,
    distortion_k1_k2_p1_p2. Raises UserError naming camera and field."""
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
        items = list(entries.items())
    except FileNotFoundError:
        raise UserError(f"{path} is missing: give the calibrated cameras with --cameras") from None
    except (json.JSONDecodeError, UnicodeDecodeError, AttributeError) as error:
        raise UserError(f"{path} is not a JSON object of cameras: {error}") from None
    lenses = {}
    for name, entry in items:
        try:
            T = np.asarray(entry["world_to_camera"], np.float64)
            numbers = [float(entry[key]) for key in ("fx", "fy", "cx", "cy")]
            camera = Camera(int(entry["width"]), int(entry["height"]), *numbers, T)
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
