"""Reading footage, with landmarks and masks beside it or found in it, the lens' distortion removed.

Three layouts are recognised::

    a video                                                                                    one camera, unknown
    frames/*.png|jpg (or one video)   masks/NAME.png   landmarks.npz                           one camera, unknown
    videos/CAM.mp4 (or frames/CAM/)   masks/CAM/NAME.png   landmarks_CAM.npz   cameras.json    calibrated cameras

A mask has the name of its frame, or its number as 000000.png when the frames come from a video. Where landmarks and
masks are both absent, a detector finds them, in the longest shot of one person.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.values.camera import Camera

from .detect import Detection, Detector
from .footage.film import Film
from .footage.lens import Lens, read_lenses
from .footage.listing import IMAGE_SUFFIXES, footage_files, is_foreign
from .footage.mask_names import match_masks
from .footage.mask_pictures import MaskReader, survey_masks
from .footage.shots import find_cuts, longest
from .footage.video_reading import VIDEO_SUFFIXES
from .handheld.room_motion import RoomMotion
from .landmarks import Landmarks, read_landmarks


@dataclasses.dataclass(frozen=True)
class Footage:
    """One camera's footage, frames chosen, brought to the size and lens of the capture as it is read.

    film: all of it. numbers: (T,) which frames of it. mask_files: T files. read_mask: gives one as (H, W) uint8 alpha.
    size: (width, height) of the capture. lens: None when the camera is unknown. landmarks: of the chosen frames, in the
    capture's undistorted pixels. empty: (H, W, 3) uint8 BGR as filmed, the room without the person, where it is known.
    motion: of the room in the capture's pixels, where the camera moves.
    """

    film: Film
    numbers: np.ndarray
    mask_files: list[Path]
    read_mask: MaskReader
    size: tuple[int, int]
    lens: Lens | None
    landmarks: Landmarks
    empty: np.ndarray | None = None
    motion: RoomMotion | None = None

    @property
    def name(self) -> str:
        """The camera's."""
        return self.film.name

    @property
    def frames(self) -> list[Path] | Path:
        """Files of the chosen frames, or the video they are in."""
        frames = self.film.frames
        return frames if isinstance(frames, Path) else [frames[k] for k in self.numbers]

    @property
    def camera(self) -> Camera | None:
        """The pinhole camera of the prepared images, or None when unknown."""
        return None if self.lens is None else self.lens.camera.resized(*self.size)

    @property
    def background(self) -> np.ndarray | None:
        """(H, W, 3) uint8 BGR of the room without the person, undistorted and resized; None where it is not known."""
        return None if self.empty is None else self._prepared(self.empty)

    def images(self) -> Iterator[np.ndarray]:
        """(H, W, 3) uint8 BGR of each chosen frame, undistorted and resized. UserError for an unreadable frame."""
        return (self._prepared(image) for image in self.film.images(self.numbers))

    def masks(self) -> Iterator[np.ndarray]:
        """(H, W) uint8 alpha of each chosen frame, undistorted and resized. UserError for a mask of another size."""
        filmed = self.film.size
        for number, path in zip(self.numbers, self.mask_files, strict=True):
            mask = self.read_mask(path)
            if mask.shape[1::-1] != filmed:
                turned = ", turned: masks must lie as their frames are seen" if mask.shape == filmed else ""
                raise UserError(
                    f"{path} (frame {number}) is {mask.shape[1]}x{mask.shape[0]} pixels, but camera '{self.name}' "
                    f"filmed {filmed[0]}x{filmed[1]}{turned}"
                )
            yield self._prepared(mask)

    def _prepared(self, image: np.ndarray) -> np.ndarray:
        if self.lens is not None:
            image = self.lens.undistort_image(image)
        if self.size != self.film.size:
            smaller = self.size[0] < self.film.size[0]
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
        found: Mapping[str, list[Path] | Path] = {"cam0": path}
        cameras_file = options.cameras
    else:
        found = _cameras_of(path)
        cameras_file = options.cameras or (path / "cameras.json" if (path / "cameras.json").is_file() else None)
    lenses = read_lenses(cameras_file) if cameras_file else {}
    if path.is_file() and len(lenses) == 1:
        lenses = {"cam0": next(iter(lenses.values()))}  # the only camera, whatever it is called there
    if not lenses and len(found) > 1:
        raise UserError(f"{path} holds {len(found)} cameras ({', '.join(found)}) but no cameras.json: give `cameras`")
    alone = len(found) == 1
    films = [Film.of(name, frames, alone and options.fps is None) for name, frames in found.items()]
    for name in found:
        if lenses and name not in lenses:
            raise UserError(f"{cameras_file} has no camera '{name}', which {path} holds (it has: {', '.join(lenses)})")
    given = [_beside(path, name, options, alone) for name in found]
    if None in given and options.fps is None and not any(film.rate for film in films):
        raise UserError(f"{path}: the footage does not say its frame rate: give `fps`")
    parts = [_take(film, lenses.get(film.name), its, options, alone) for film, its in zip(films, given, strict=True)]
    footage = [part.footage for part in parts]
    if len({len(f.numbers) for f in footage}) > 1:
        counts = ", ".join(f"{f.name} {len(f.numbers)}" for f in footage)
        raise UserError(
            f"{path}: the cameras have different numbers of frames ({counts}); choose common ones by `frames`"
        )
    fps = options.fps or next((part.rate for part in parts if part.rate), None)
    if fps is None:
        raise UserError(f"{path}: neither landmarks nor video say the frame rate: give `fps`")
    notes = [note for part in parts for note in part.notes]
    if path.is_file() and None in given and path.with_suffix(".npz").is_file():
        notes.append(
            f"{path.with_suffix('.npz').name} lies beside the video and is not read: name it by `landmarks` (and its "
            "masks by `masks`) if it holds this video's landmarks"
        )
    description = (
        f"{len(footage)} camera{'s' * (len(footage) > 1)} ({', '.join(found)}), {len(footage[0].numbers)} frames from "
        f"{'video' if isinstance(films[0].frames, Path) else 'image'} files at {fps:.4g} fps, "
        f"{'calibrated' if lenses else 'camera unknown'}, "
        f"{'the person found in them' if None in given else 'with landmarks and masks'}"
    )
    return Source(footage, fps / parts[0].step, description, notes)


def _cameras_of(folder: Path) -> Mapping[str, list[Path] | Path]:
    """Image files or a video of every camera in a folder."""
    for base in (folder / "videos", folder / "frames"):
        if not base.is_dir():
            continue
        videos = sorted(footage_files(base, VIDEO_SUFFIXES))
        if videos:
            return {p.stem: p for p in videos}
        images = footage_files(base, IMAGE_SUFFIXES)
        if images:
            return {"cam0": images}
        folders = [p for p in sorted(base.iterdir()) if p.is_dir() and not is_foreign(p)]
        cameras = {p.name: footage_files(p, IMAGE_SUFFIXES) for p in folders}
        cameras = {name: images for name, images in cameras.items() if images}
        if cameras:
            return cameras
    videos = footage_files(folder, VIDEO_SUFFIXES)
    if len(videos) == 1:
        return {"cam0": videos[0]}
    raise UserError(f"{folder} holds no footage: it needs frames/ with images, one video, or videos/CAM.mp4")


@dataclasses.dataclass(frozen=True)
class _Taken:
    """One camera's footage, the rate of all its moments, how many are between two chosen ones, and what is to be said
    of it."""

    footage: Footage
    rate: float | None
    step: int
    notes: list[str]


def _take(
    film: Film, lens: Lens | None, given: tuple[Path, Path] | None, options: SourceOptions, alone: bool
) -> _Taken:
    """given: landmarks file and folder of masks, or None to look for the person. alone: no other camera's frames must
    be chosen too."""
    name, filmed = film.name, film.size
    if lens is not None and (lens.camera.width, lens.camera.height) != filmed:
        raise UserError(
            f"cameras.json: camera '{name}' is {lens.camera.width}x{lens.camera.height}, but its footage is "
            f"{filmed[0]}x{filmed[1]}"
        )
    frames, longest_side, notes = _how_much(film, given, options)
    moments = np.arange(len(film.order))[frames]
    if not len(moments):
        raise UserError(
            f"`frames` leaves nothing of the {len(film.order)} frames of '{name}': choose a range inside "
            f"0:{len(film.order)}"
        )
    cuts, empty, motion = find_cuts(film.images(film.order[moments])), None, None
    if given is None:
        assert options.detector is not None  # `_beside` gives None only where something can look for the person
        moments, said = _one_shot(film, moments, cuts, "the scene changes", alone)
        notes += said
        found, rate, moments, said = _found(film, moments, options.detector, alone)
        chosen, masks, empty, motion = found.landmarks, found.mask_files, found.background, found.motion
        reader = MaskReader(False, False, 255)
    else:
        notes += _one_shot(film, moments, cuts, "the scene changes", False)[1]
        landmarks, numbers = _read_matching(given[0], film), film.order[moments]
        chosen, rate = landmarks[numbers], (landmarks.fps if film.even else None) or film.rate
        masks, how = match_masks(given[1], film.stems, numbers.tolist())
        reader, said = survey_masks(given[1], masks)
        notes += [how] if how else []
    scale = 1.0 if longest_side is None else longest_side / max(filmed)
    size = (max(1, round(filmed[0] * scale)), max(1, round(filmed[1] * scale)))
    straight = lens.undistort_points if lens is not None and np.any(lens.distortion) else None
    chosen = chosen.moved(straight, size, filmed)
    if motion is not None:
        motion = None if lens is not None else motion.scaled(*(np.array(size) / filmed))
    footage = Footage(film, film.order[moments], masks, reader, size, lens, chosen, empty, motion)
    return _Taken(footage, rate, frames.step or 1, [*film.notes, *notes, *said])


def _how_much(film: Film, given: tuple[Path, Path] | None, options: SourceOptions
              ) -> tuple[slice, int | None, list[str]]:  # fmt: skip
    """Which moments, how many pixels of the longer side (None: all), and sentences where raw footage is too much."""
    frames, longest_side, notes, count = options.frames, options.size, [], len(film.order)
    if given is None and frames == slice(None) and options.most_frames and count > options.most_frames:
        frames = slice(None, None, -(-count // options.most_frames))
        notes.append(f"{film.name}: every {_ordinal(frames.step)} of {count} frames is taken (`max_frames`, `frames`)")
    if given is None and longest_side is None and options.largest and max(film.size) > options.largest:
        longest_side = options.largest
        notes.append(
            f"{film.name}: {film.size[0]}x{film.size[1]} pixels are reduced to {longest_side} on the longer side "
            "(`size`)"
        )
    return frames, longest_side, notes


def _found(film: Film, moments: np.ndarray, detector: Detector, alone: bool
           ) -> tuple[Detection, float | None, np.ndarray, list[str]]:  # fmt: skip
    """What looking finds in the moments of the person seen longest, the rate, these moments, and notes."""
    numbers = film.order[moments]
    detection = detector(film.name, lambda: film.images(numbers), numbers, film.rate)
    kept, said = _one_shot(film, moments, detection.changes, "another person is followed", alone)
    first = int(np.searchsorted(moments, kept[0]))
    part = slice(first, first + len(kept))
    seen = dataclasses.replace(
        detection, landmarks=detection.landmarks[part], mask_files=detection.mask_files[part],
        motion=detection.motion and detection.motion.taken(part),
    )  # fmt: skip
    return seen, film.rate, kept, detection.notes + said


def _one_shot(film: Film, moments: np.ndarray, starts: list[int], what: str, choose: bool
              ) -> tuple[np.ndarray, list[str]]:  # fmt: skip
    """The longest piece between `starts` (indices of `moments`) where one may `choose`, else all; and what to say."""
    if not starts:
        return moments, []
    kept = moments[longest(starts, len(moments))]
    first, last = int(kept[0]), int(kept[-1]) + 1
    at = ", ".join(f"{moments[k]}" + (f" ({moments[k] / film.rate:.2f} s)" if film.rate else "") for k in starts[:6])
    more = ", ..." if len(starts) > 6 else ""
    done = (
        f"only the longest part is taken, `frames={first}:{last}`; choose another by `frames`" if choose
        else f"all of it is taken; choose one part by `frames`, the longest is `frames={first}:{last}`"
    )  # fmt: skip
    return (kept if choose else moments), [f"{film.name}: {what} at frame {at}{more}: {done}"]


def _ordinal(n: int) -> str:
    return {2: "second", 3: "third"}.get(n, f"{n}th")


def _read_matching(path: Path, film: Film) -> Landmarks:
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
    if path.is_file() and not asked:
        raise UserError(
            f"{masks} lies beside {path.name}, but no landmarks are named: give `landmarks`, or rename {masks.name} so "
            "that both are found in the video"
        )
    raise UserError(
        f"{missing} is missing: give {option}; without landmarks and masks (both) they are found in the footage"
    )


def _landmarks_file(path: Path, name: str, options: SourceOptions, alone: bool) -> Path:
    """The first that exists of the places where a camera's landmarks may lie, or the most usual of them."""
    given = options.landmarks
    if given is not None and given.is_file() and alone:
        return given
    base = path if given is None else given  # what lies beside a video that was named need not belong to it
    choices = [base / "landmarks.npz"] * alone + [base / f"landmarks_{name}.npz", base / f"{name}.npz"]
    return next((choice for choice in choices if choice.is_file()), choices[0])


def _mask_folder(path: Path, name: str, options: SourceOptions, alone: bool) -> Path:
    base = options.masks or (path.with_name(f"{path.stem}_masks") if path.is_file() else path / "masks")
    return base if alone and not (base / name).is_dir() else base / name
