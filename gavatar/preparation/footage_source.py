"""Reading footage, with landmarks and masks beside it or found in it, the lens' distortion removed.

Three layouts are recognised::

    a video                                                                                    one camera, unknown
    frames/*.png|jpg (or one video)   masks/NAME.png   landmarks.npz                           one camera, unknown
    videos/CAM.mp4 (or frames/CAM/)   masks/CAM/NAME.png   landmarks_CAM.npz   cameras.json    calibrated cameras

A mask has the name of its frame, or its number as 000000.png when the frames come from a video. Where landmarks and
masks are both absent, a detector finds them.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.values.camera import Camera

from .detect import Detector
from .landmarks import Landmarks, read_landmarks
from .video_reading import VIDEO_SUFFIXES, video_facts, video_frames

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")


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
        raw = video_frames(self.frames, self.numbers) if isinstance(self.frames, Path) else map(_image, self.frames)
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
    found, for the user. notes: what is wrong with the footage, sentences."""

    footage: list[Footage]
    fps: float
    description: str
    notes: list[str] = dataclasses.field(default_factory=list)


@dataclasses.dataclass(frozen=True)
class SourceOptions:
    """Where things are when not in their usual place, and what to take: see `gavatar-prepare --help`."""

    landmarks: Path | None = None
    masks: Path | None = None
    cameras: Path | None = None
    fps: float | None = None
    frames: slice = dataclasses.field(default_factory=lambda: slice(None))
    size: int | None = None
    detector: Detector | None = None  # finds landmarks and masks where there are none
    most_frames: int | None = None  # of footage that is given to the detector
    largest: int | None = None  # pixels of the longer side, of footage that is given to the detector


def open_source(path: Path, options: SourceOptions | None = None) -> Source:
    """Recognise the layout of `path` (a folder or a video) and check it whole; find the person where nothing says
    where they are and options.detector can.

    Raises UserError, naming the file and the fix, for whatever is missing or does not fit together.
    """
    options = options or SourceOptions()
    if not path.exists():
        raise UserError(f"{path} does not exist: give a folder of footage or a video")
    if path.is_file():
        if path.suffix.lower() not in VIDEO_SUFFIXES:
            raise UserError(f"{path} is no video ({', '.join(VIDEO_SUFFIXES)}): give a folder of footage or a video")
        found, cameras_file = {"cam0": path}, options.cameras
    else:
        found = _cameras_of(path)
        cameras_file = options.cameras or (path / "cameras.json" if (path / "cameras.json").is_file() else None)
    lenses = read_lenses(cameras_file) if cameras_file else {}
    if path.is_file() and len(lenses) == 1:
        lenses = {"cam0": next(iter(lenses.values()))}  # the only camera, whatever it is called there
    if not lenses and len(found) > 1:
        raise UserError(f"{path} holds {len(found)} cameras ({', '.join(found)}) but no cameras.json: give `cameras`")
    films, alone = [_Film.of(name, frames) for name, frames in found.items()], len(found) == 1
    for name in found:
        if lenses and name not in lenses:
            raise UserError(f"{cameras_file} has no camera '{name}', which {path} holds (it has: {', '.join(lenses)})")
    given = [_beside(path, name, options, alone) for name in found]
    if None in given and options.fps is None and not any(film.rate for film in films):
        raise UserError(f"{path}: the footage does not say its frame rate: give `fps`")
    parts = [_footage(film, lenses.get(film.name), its, options) for film, its in zip(films, given, strict=True)]
    footage = [one for one, _, _ in parts]
    if len({len(f.numbers) for f in footage}) > 1:
        counts = ", ".join(f"{f.name} {len(f.numbers)}" for f in footage)
        raise UserError(
            f"{path}: the cameras have different numbers of frames ({counts}); choose common ones by `frames`"
        )
    fps = options.fps or next((rate for _, rate, _ in parts if rate), None)
    if fps is None:
        raise UserError(f"{path}: neither landmarks nor video say the frame rate: give `fps`")
    numbers = footage[0].numbers
    description = (
        f"{len(footage)} camera{'s' * (len(footage) > 1)} ({', '.join(found)}), {len(numbers)} frames from "
        f"{'video' if isinstance(films[0].frames, Path) else 'image'} files at {fps:.4g} fps, "
        f"{'calibrated' if lenses else 'camera unknown'}, "
        f"{'the person found in them' if None in given else 'with landmarks and masks'}"
    )
    step = int(numbers[1] - numbers[0]) if len(numbers) > 1 else 1
    return Source(footage, fps / step, description, [note for _, _, notes in parts for note in notes])


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


@dataclasses.dataclass(frozen=True)
class _Film:
    """One camera's raw material. frames: image files or a video. stems: names of all its masks."""

    name: str
    frames: list[Path] | Path
    stems: list[str]
    rate: float | None
    size: tuple[int, int]

    @staticmethod
    def of(name: str, frames: list[Path] | Path) -> _Film:
        if isinstance(frames, Path):
            facts = video_facts(frames)
            return _Film(name, frames, [f"{k:06d}" for k in range(facts.count)], facts.rate, facts.size)
        return _Film(name, frames, [p.stem for p in frames], None, _image(frames[0]).shape[1::-1])

    def images(self, numbers: np.ndarray) -> Iterator[np.ndarray]:
        if isinstance(self.frames, Path):
            return video_frames(self.frames, numbers)
        return (_image(self.frames[k]) for k in numbers)


def _footage(film: _Film, lens: Lens | None, given: tuple[Path, Path] | None, options: SourceOptions
             ) -> tuple[Footage, float | None, list[str]]:  # fmt: skip
    """One camera's footage, its frame rate and what is to be said of it. given: landmarks file and folder of masks, or
    None to look for the person."""
    name, count, filmed = film.name, len(film.stems), film.size
    if lens is not None and (lens.camera.width, lens.camera.height) != filmed:
        raise UserError(
            f"cameras.json: camera '{name}' is {lens.camera.width}x{lens.camera.height}, but its footage is "
            f"{filmed[0]}x{filmed[1]}"
        )
    frames, longest, notes = options.frames, options.size, []
    if given is None:
        if frames == slice(None) and options.most_frames and count > options.most_frames:
            frames = slice(None, None, -(-count // options.most_frames))
            notes.append(f"{name}: every {_ordinal(frames.step)} of {count} frames is taken (`max_frames`, `frames`)")
        if longest is None and options.largest and max(filmed) > options.largest:
            longest = options.largest
            notes.append(f"{name}: {filmed[0]}x{filmed[1]} pixels are reduced to {longest} on the longer side (`size`)")
    numbers = np.arange(count)[frames]
    if not len(numbers):
        raise UserError(f"`frames` leaves nothing of the {count} frames of '{name}': choose a range inside 0:{count}")
    if given is None:
        detection = options.detector(name, lambda: film.images(numbers), numbers, film.rate)
        chosen, masks, rate, notes = detection.landmarks, detection.mask_files, film.rate, notes + detection.notes
    else:
        landmarks = _read_matching(given[0], film)
        chosen, rate = landmarks[numbers], landmarks.fps or film.rate
        masks = _mask_files(given[1], [film.stems[k] for k in numbers])
    scale = 1.0 if longest is None else longest / max(filmed)
    size = (max(1, round(filmed[0] * scale)), max(1, round(filmed[1] * scale)))
    image = lens.undistort_points(chosen.image) if lens is not None and np.any(lens.distortion) else chosen.image
    chosen = dataclasses.replace(chosen, image=image * (np.array(size) / filmed), width=size[0], height=size[1])
    paths = film.frames if isinstance(film.frames, Path) else [film.frames[k] for k in numbers]
    return Footage(name, paths, numbers, masks, filmed, size, lens, chosen), rate, notes


def _ordinal(n: int) -> str:
    return {2: "second", 3: "third"}.get(n, f"{n}th")


def _read_matching(path: Path, film: _Film) -> Landmarks:
    landmarks = read_landmarks(path)
    if len(landmarks) != len(film.stems):
        raise UserError(f"{path} has {len(landmarks)} frames, but the footage of '{film.name}' has {len(film.stems)}")
    if landmarks.width and landmarks.height and (landmarks.width, landmarks.height) != film.size:
        raise UserError(
            f"{path} was made for {landmarks.width}x{landmarks.height} pixels, but the footage of '{film.name}' "
            f"is {film.size[0]}x{film.size[1]}"
        )
    return landmarks


def _beside(path: Path, name: str, options: SourceOptions, alone: bool) -> tuple[Path, Path] | None:
    """Landmarks file and folder of masks that come with the footage at `path`; None when it has neither. UserError when
    only one of them is there, or when neither is and nothing can look for the person."""
    landmarks, masks = _landmarks_file(path, name, options, alone), _mask_folder(path, name, options, alone)
    if landmarks.is_file() and masks.is_dir():
        return landmarks, masks
    asked = options.landmarks is not None or options.masks is not None
    if options.detector is not None and not asked and not landmarks.is_file() and not masks.is_dir():
        return None
    missing, option = (masks, "`masks`") if landmarks.is_file() else (landmarks, "`landmarks`")
    raise UserError(
        f"{missing} is missing: give {option}; without landmarks and masks (both) they are found in the footage"
    )


def _landmarks_file(path: Path, name: str, options: SourceOptions, alone: bool) -> Path:
    """The first that exists of the places where a camera's landmarks may lie, or the most usual of them."""
    given = options.landmarks
    if given is not None and given.is_file() and alone:
        return given
    if path.is_file() and given is None:  # what lies beside a video that was named need not belong to it
        return path.with_suffix(".npz")
    base = path if given is None else given
    choices = [base / "landmarks.npz"] * alone + [base / f"landmarks_{name}.npz", base / f"{name}.npz"]
    return next((choice for choice in choices if choice.is_file()), choices[0])


def _mask_folder(path: Path, name: str, options: SourceOptions, alone: bool) -> Path:
    base = options.masks or (path.with_name(f"{path.stem}_masks") if path.is_file() else path / "masks")
    return base if alone and not (base / name).is_dir() else base / name


def _mask_files(folder: Path, stems: list[str]) -> list[Path]:
    files = [folder / f"{stem}.png" for stem in stems]
    missing = [path for path in files if not path.is_file()]
    if missing:
        raise UserError(f"{missing[0]} is missing ({len(missing)} of {len(files)} masks): every frame needs its mask")
    return files


def _image(path: Path, flag: int = cv2.IMREAD_COLOR) -> np.ndarray:
    image = cv2.imread(str(path), flag)
    if image is None:
        raise UserError(f"{path} cannot be read as an image: it is damaged or of an unknown format")
    return image


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
