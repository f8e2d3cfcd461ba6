"""ZJU-MoCap captures (Peng et al. 2021), and others that were brought into Neural Body's layout."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sized
from pathlib import Path, PureWindowsPath
from typing import Any

import cv2
import numpy as np

from gavatar.capture.capture import Capture, View, read_image
from gavatar.capture.placement import Placement, upright
from gavatar.capture.reading import camera, image_size, matrix, person_masks, pose_field, require, with_images
from gavatar.protocols import CaptureReader
from gavatar.registry import CAPTURES
from gavatar_runtime.errors import Faults, UserError
from gavatar_runtime.formats.numpy_file import load_npy
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.notes import Note
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

TRAINING_CAMERAS = (0, 6, 12, 18)
NEAREST = 50.0  # millimetres, of the farthest camera from the origin
# Neural Body's configs/zju_mocap_exp: first training frame and their number; 300 from the first elsewhere
PUBLISHED = {"CoreView_313": (0, 60), "CoreView_315": (0, 400), "CoreView_390": (700, 300)}


@dataclasses.dataclass
class ZjuOptions:
    """cameras: numbers of the training cameras, e.g. 0,6,12,18 (the published ones, default); the others' images of the
    training frames are the split novel_view. first, frames, step: the training frames; -1 for the sequence's published
    ones. novel_poses: how many of the frames that follow are the split novel_pose. params: folder of the SMPL
    parameters, by default new_params or params. fps: the files do not say."""

    cameras: str = ""
    first: int = -1
    frames: int = -1
    step: int = 1
    novel_poses: int = 100
    params: str = ""
    fps: float = 50.0


@CAPTURES.register("zju", config=ZjuOptions, summary="ZJU-MoCap: annots.npy, several cameras, params/, mask_cihp/")
class ZjuCapture(CaptureReader):
    """annots.npy: cams K (3x3), D (5, OpenCV), R (3x3), T (3, millimetres, or metres where no camera would be 5 cm from
    the origin; world to camera) and ims, a list of {ims: [path, ...]} with a path for each camera, slashes of either
    kind; pixel positions count from pixel centres. mask_cihp/PATH.png or mask/PATH.png: not zero on the person.
    params/FRAME.npy: poses (72), shapes (10), Rh and Th (3), the model posed and then turned by Rh about its origin and
    moved by Th."""

    signs = "annots.npy"

    def __init__(self, config: ZjuOptions):
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether the folder looks like this layout."""
        return (path / "annots.npy").is_file()

    def read(self, path: Path, faults: Faults | None = None) -> Capture:
        """Open the capture; UserError when malformed, after all faults were collected if `faults` does."""
        path, faults = Path(path), faults or Faults()
        annots = path / "annots.npy"
        content = faults.of(_annots, annots)
        frames: Any = faults.of(_frames, annots, content, len(content["cams"]["K"])) if content else None
        sizes = faults.of(_sizes, path, frames) if frames else None
        cameras: Any = faults.of(_cameras, annots, content["cams"], sizes) if content else None
        chosen: Any = faults.of(self._chosen, path, frames) if frames else None
        placed: Any = faults.of(self._motion, path, frames, chosen) if chosen else None
        if chosen is None:  # it will not be opened, but what is wrong with the parameters is told too
            faults.of(self._loose_parameters, path)
        faults.stop()
        placement, rows = placed
        splits = self._splits(annots, chosen, len(cameras), rows)

        def image_path(view: View) -> Path:
            return path / frames[chosen[2][view.frame]][int(view.camera)]

        def mask_path(view: View) -> Path:
            relative = Path(frames[chosen[2][view.frame]][int(view.camera)]).with_suffix(".png")
            return next(
                (p for m in ("mask_cihp", "mask") if (p := path / m / relative).is_file()),
                path / "mask_cihp" / relative,
            )

        splits = with_images(annots, splits, image_path)
        return Capture(
            path=path,
            name=path.resolve().name,
            license="unknown",
            source="ZJU-MoCap",
            body_model="smpl",
            background="footage",
            cameras={name: placement.camera(c) for name, c in cameras.items()},
            splits=splits,
            motion=placement.motion(),
            truth=None,
            image_path=image_path,
            mask_path=mask_path,
            read_mask=person_masks([mask_path(view) for view in splits["train"]], _mask),
            lenses={str(i): _lens(annots, content["cams"], i) for i in range(len(cameras))},
            listing="annots.npy",
            placement=placement,
        )

    def _chosen(self, path: Path, frames: list) -> tuple[int, int, list[int]]:
        """Numbers of training and novel-pose frames, and which of the sequence's frames they are, in this order."""
        first, count = PUBLISHED.get(path.resolve().name, (0, 300))
        first = self.config.first if self.config.first >= 0 else first
        count = self.config.frames if self.config.frames >= 0 else count
        if self.config.step < 1:
            raise UserError(f"capture_format.step={self.config.step}: give a whole number from 1 up")
        train = list(range(first, min(first + count * self.config.step, len(frames)), self.config.step))
        if not train:
            raise UserError(
                f"{path / 'annots.npy'} lists {len(frames)} frames: none from {first} on; give capture_format.first"
            )
        after = list(range(train[-1] + 1, len(frames), self.config.step))[: max(0, self.config.novel_poses)]
        return len(train), len(after), train + after

    def _motion(self, path: Path, frames: list, chosen: tuple[int, int, list[int]]) -> tuple[Placement, int]:
        """The placement, and how many of the chosen frames have parameters: those after the last are left out."""
        folder = self._params(path)
        images, faults = [frames[f][0] for f in chosen[2]], Faults(collect=True)
        numbers = faults.each(lambda image: _number(image, path.resolve().name), images, "images without number")
        faults.stop()
        files = _parameter_files(folder, numbers, chosen[2], len(frames))
        # parameters may end before the frames for novel poses do; those of training frames are owed
        there = next((i for i, file in enumerate(files) if i >= chosen[0] and not file.is_file()), len(files))

        def parameters(i: int) -> tuple[np.ndarray, ...]:
            return _parameters(files[i], f"annots.npy lists {images[i]}")

        rows = faults.each(parameters, range(there), f"files of {folder} are faulty")
        faults.stop()
        poses, Rh, Th, shapes = (np.stack([row[i] for row in rows]) for i in range(4))
        pivots = matrix_from_axis_angle(Rh)
        poses = poses.reshape(there, -1, 3)
        poses[:, 0] = axis_angle_from_matrix(pivots @ matrix_from_axis_angle(poses[:, 0]))
        motion = Motion(poses, Th, self.config.fps, shapes.mean(0).astype(np.float32), path.resolve().name)
        return Placement(motion, "smpl", upright(poses), pivots), there

    def _loose_parameters(self, path: Path) -> None:
        """UserError for what is wrong with the parameters' files, whatever frames they are of."""
        folder, faults = self._params(path), Faults(collect=True)
        faults.each(lambda file: _parameters(file, ""), sorted(folder.glob("*.npy")), f"files of {folder} are faulty")
        faults.stop()

    def _params(self, path: Path) -> Path:
        names = (self.config.params,) if self.config.params else ("new_params", "params")
        found = next((path / name for name in names if (path / name).is_dir()), None)
        if found is None:
            raise UserError(f"{path / names[-1]} is missing: the folder of SMPL parameters, FRAME.npy")
        return found

    def _splits(self, annots: Path, chosen: tuple, cameras: int, rows: int) -> dict[str, list[View]]:
        train, after, _ = chosen
        after = min(after, rows - train)
        try:
            asked = [int(c) for c in self.config.cameras.split(",")] if self.config.cameras else TRAINING_CAMERAS
        except ValueError:
            raise UserError(f"capture_format.cameras={self.config.cameras}: give numbers, as in 0,6,12,18") from None
        unknown = [c for c in asked if not 0 <= c < cameras]
        if self.config.cameras and unknown:
            raise UserError(f"{annots} has cameras 0 to {cameras - 1}, not {unknown[0]}: set capture_format.cameras")
        used = [c for c in asked if 0 <= c < cameras] or [0]
        others = [c for c in range(cameras) if c not in used]
        splits = {
            "train": [View(str(c), f) for f in range(train) for c in used],
            "novel_view": [View(str(c), f) for f in range(train) for c in others],
            "novel_pose": [View(str(c), f) for f in range(train, train + after) for c in others or used],
        }
        return {split: views for split, views in splits.items() if views}


def _annots(path: Path) -> dict:
    content = load_npy(path)
    fields: tuple[str, ...] = ("cams", "ims")
    missing = [] if isinstance(content, dict) else fields
    missing = missing or [f for f in fields if f not in content or (f == "cams" and not isinstance(content[f], dict))]
    if missing:
        raise UserError(*(f"{path}: field '{f}' is missing: expected a dictionary of cams and ims" for f in missing))
    cams, fields = content["cams"], ("K", "D", "R", "T")
    require(path, cams, fields, "cams: ")
    counts = {field: len(cams[field]) if isinstance(cams[field], Sized) else 0 for field in fields}
    most = max(counts.values())
    faulty = [
        f"{path}: cams: {field} holds {counts[field]} cameras" + (f", others {most}" if most else "")
        for field in fields
        if counts[field] != most or most == 0
    ]
    if faulty:
        raise UserError(*faulty)
    return content


def _frames(path: Path, content: dict, cameras: int) -> list[list[str]]:
    """Image paths by frame and camera."""
    entries = content.get("ims")
    if not isinstance(entries, list | tuple | np.ndarray) or not len(entries):
        raise UserError(
            f"{path}: field 'ims' is missing or empty: take the data set's own annots.npy, which lists the images (the "
            "refined release's annots_new.npy holds cameras alone)"
        )

    def frame(i: int) -> list[str]:
        names = entries[i].get("ims") if isinstance(entries[i], dict) else None
        if not isinstance(names, list | tuple | np.ndarray) or len(names) != cameras:
            raise UserError(f"{path}: ims: frame {i} must list {cameras} images, one a camera")
        # as Windows writes paths
        names = [str(name).replace("\\", "/") for name in names]
        outside = [n for n in names if PureWindowsPath(n).anchor or ".." in Path(n).parts or "\0" in n]
        if outside:
            raise UserError(
                *(f"{path}: ims: frame {i} names '{name}', which lies outside of the capture" for name in outside)
            )
        return names

    faults = Faults(collect=True)
    frames = faults.each(frame, range(len(entries)), f"frames of ims in {path} are faulty")
    faults.stop()
    return frames


def _sizes(path: Path, frames: list[list[str]]) -> list[tuple[int, int]]:
    """Width and height of each camera's first image; of a camera without any, which is left out, some other's."""
    first = [next((p for frame in frames if (p := path / frame[c]).is_file()), None) for c in range(len(frames[0]))]
    faults = Faults(collect=True)
    some = [image for image in first if image is not None] or [path / frames[0][0]]
    sizes = faults.each(image_size, some, f"images of {path} are faulty")
    faults.stop()
    known = dict(zip(some, sizes, strict=True))
    return [sizes[0] if image is None else known.get(image, sizes[0]) for image in first]


def _metres(path: Path, cams: dict[str, Any]) -> float:
    """What the cameras' translations are multiplied by: ZJU-MoCap's are millimetres, but people write metres too, which
    no camera is near enough to the origin of its world to be taken for."""
    largest = 0.0
    for T in cams["T"]:
        values = np.asarray(T)
        if values.dtype.kind in "fiu" and np.isfinite(values).all():
            largest = max(largest, float(np.linalg.norm(values.astype(np.float64))))
    if not 0 < largest < NEAREST:
        return 1e-3
    warnings.warn(f"{path}: cams: T is at most {largest:.3g}: taken as metres, where this layout has millimetres", Note)
    return 1.0


def _cameras(path: Path, cams: dict[str, Any], sizes: list[tuple[int, int]] | None) -> dict[str, Camera]:
    """sizes: width and height by camera; None where they are not known and something else is at fault."""
    metres = _metres(path, cams)

    def one(i: int) -> Camera:
        faults = Faults(collect=True)
        K, R, T = (f"cams: {field} of camera {i}" for field in "KRT")
        rotation = faults.of(matrix, path, R, cams["R"][i], (3, 3))
        offset = faults.of(matrix, path, T, np.reshape(cams["T"][i], -1), (3,))
        whole = np.eye(4)
        if rotation is not None and offset is not None:
            whole[:3] = np.c_[rotation, offset * metres]
        size = sizes[i] if sizes else (1, 1)
        made = faults.of(camera, path, cams["K"][i], whole, size, shift=0.5, names=(K, R))
        faults.of(_lens, path, cams, i)
        faults.stop()
        return made

    faults = Faults(collect=True)
    made = faults.each(one, range(len(cams["K"])), f"cameras of {path} are faulty")
    faults.stop()
    return {str(i): camera for i, camera in enumerate(made)}


def _lens(path: Path, cams: dict[str, Any], i: int) -> np.ndarray:
    return matrix(path, f"cams: D of camera {i}", np.reshape(cams["D"][i], -1), (4,), (5,), (8,))


def _number(image: str, sequence: str) -> int:
    """The frame number in an image's name: that of its parameter file."""
    stem = Path(image).stem
    part = stem.split("_")[4] if sequence in ("CoreView_313", "CoreView_315") and stem.count("_") > 4 else stem
    try:
        return int(part)
    except ValueError:
        raise UserError(f"annots.npy names image '{image}', whose name is no frame number") from None


def _parameter_files(folder: Path, numbers: list[int], places: list[int], listed: int) -> list[Path]:
    """The file of each frame by its number, with zeros in front or without; by its place among those listed, with a
    note, where the files are numbered otherwise and are as many as the frames."""
    found = {int(p.stem): p for p in sorted(folder.glob("*.npy")) if p.stem.isascii() and p.stem.isdigit()}
    if len(found) == listed and not found.keys() >= set(numbers):
        warnings.warn(
            f"{folder} numbers its {listed} files from {min(found)} on, the images of annots.npy start at "
            f"{min(numbers)}: paired in their order", Note,
        )  # fmt: skip
        ordered = [found[number] for number in sorted(found)]
        return [ordered[place] for place in places]
    return [found.get(number, folder / f"{number}.npy") for number in numbers]


def _parameters(path: Path, reason: str) -> tuple[np.ndarray, ...]:
    """poses (72), Rh (3), Th (3) and shapes (10) of one frame. reason: why the file should be there."""
    if not path.is_file():
        raise UserError(f"{path} is missing, though {reason}")
    content = load_npy(path)
    if not isinstance(content, dict):
        raise UserError(f"{path} holds no dictionary of poses, shapes, Rh and Th")
    shapes = {"poses": (72,), "Rh": (3,), "Th": (3,), "shapes": (10,)}
    faults = Faults(collect=True)
    faults.of(require, path, content, tuple(shapes))
    values = [faults.of(pose_field, path, k, content, shape) for k, shape in shapes.items() if k in content]
    faults.stop()
    return tuple(values)


def _mask(path: Path) -> np.ndarray:
    """(H, W) uint8 alpha: every label of the parsing is the person."""
    labels = read_image(path, cv2.IMREAD_UNCHANGED)
    labels = labels if labels.ndim == 2 else labels[..., :3].max(-1)
    return np.where(labels > 0, 255, 0).astype(np.uint8)
