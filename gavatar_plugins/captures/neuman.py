"""NeuMan captures (Jiang et al. 2022) as published: a moving camera, COLMAP, poses aligned to its scene."""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gavatar.capture.capture import Capture, View, read_image
from gavatar.capture.placement import Placement, levelled
from gavatar.capture.reading import IMAGES, camera, images_of, matrix, npy_mask, person_masks, require, with_images
from gavatar.protocols import CaptureReader
from gavatar.registry import CAPTURES
from gavatar_runtime.errors import Faults, UserError
from gavatar_runtime.formats.joblib_file import load_joblib
from gavatar_runtime.formats.numpy_file import load_npy
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, matrix_from_quaternion
from gavatar_runtime.notes import Note
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

CAM = "cam0"
# COLMAP's models: the number of parameters, and how many of them are focal lengths
MODELS = {
    "SIMPLE_PINHOLE": (3, 1), "PINHOLE": (4, 2), "SIMPLE_RADIAL": (4, 1), "RADIAL": (5, 1), "OPENCV": (8, 2),
    "FULL_OPENCV": (12, 2),
}  # fmt: skip
SPLITS = ("train", "val", "test")


@dataclasses.dataclass
class NeuManOptions:
    """poses: `optimized`, `romp` (smpl_output_*.pkl) or `auto`, the first of them that is there. fps: of the video."""

    poses: str = "auto"
    fps: float = 30.0


@CAPTURES.register(
    "neuman", config=NeuManOptions, summary="NeuMan as published: sparse/, alignments.npy, smpl_output_*.pkl"
)
class NeuManCapture(CaptureReader):
    """sparse/cameras.txt and images.txt: COLMAP's, positions count from the image's corner; lens distortion is left
    out, as NeuMan does. images/, segmentations/NAME or NAME.npy (255 on what is not the person).
    smpl_output_optimized.pkl or smpl_output_romp.pkl: {1: pose (T, 72), betas (T, 10)}, rows by the number in the
    image's name. alignments.npy: {image name: (4, 3)}, a row [x, 1] of the posed model times which is its place in
    COLMAP's scene, with a scale; the scene of each frame is shrunk to metres here, which no image shows. Splits:
    train|val|test_split.txt, else the authors' rule (every fifth image to test, then val)."""

    signs = "alignments.npy and sparse/"

    def __init__(self, config: NeuManOptions):
        if config.poses not in ("auto", "optimized", "romp"):
            raise UserError(f"capture_format.poses={config.poses}: choose from auto, optimized, romp")
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether the folder looks like this layout."""
        return (path / "alignments.npy").is_file() and (path / "sparse").is_dir()

    def read(self, path: Path, faults: Faults | None = None) -> Capture:
        """Open the capture; UserError when malformed, after all faults were collected if `faults` does."""
        path, faults = Path(path), faults or Faults()
        colmap = faults.of(_colmap, path / "sparse")
        names = sorted(colmap or {})
        alignments = faults.of(_alignments, path / "alignments.npy", names)
        poses = faults.of(self._poses, path, names)
        splits: Any = faults.of(_splits, path, names) if colmap else None
        faults.stop()
        placement, scale = _placement(poses, alignments, self.config.fps)
        moving = {}
        for f, name in enumerate(names):
            T = colmap[name].T_camera_world.copy()
            T[:3, 3] /= scale[f]
            moving[View(CAM, f)] = placement.camera(dataclasses.replace(colmap[name], T_camera_world=T))

        def image_path(view: View) -> Path:
            return path / "images" / names[view.frame]

        def mask_path(view: View) -> Path:
            return _mask_path(path / "segmentations", names[view.frame])

        splits = with_images(path / "sparse/images.txt", splits, image_path)
        return Capture(
            path=path,
            name=path.resolve().name,
            license="unknown",
            source="NeuMan",
            body_model="smpl",
            background="footage",
            cameras={CAM: moving[View(CAM, 0)]},
            splits=splits,
            motion=placement.motion(),
            truth=None,
            image_path=image_path,
            mask_path=mask_path,
            read_mask=person_masks([mask_path(view) for view in splits["train"]], _mask, "255"),
            moving=moving,
            listing="sparse/images.txt",
            placement=placement,
        )

    def _poses(self, path: Path, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
        """(T, 72) and (10,) of the images in the order of their names."""
        kinds = ("optimized", "romp") if self.config.poses == "auto" else (self.config.poses,)
        files = [path / f"smpl_output_{kind}.pkl" for kind in kinds]
        file = next((f for f in files if f.is_file()), None)
        if file is None:
            raise UserError(f"{files[-1]} is missing")
        content = load_joblib(file)
        person = next(iter(content.values())) if isinstance(content, dict) and len(content) == 1 else None
        if not isinstance(person, dict):
            raise UserError(f"{file} must hold one person: a dictionary of pose and betas")
        require(file, person, ("pose", "betas"))
        faults = Faults(collect=True)
        pose = faults.of(_frames_of, file, "pose", person["pose"], 72)
        betas = faults.of(_frames_of, file, "betas", person["betas"], None)
        rows = None
        if pose is not None and names:
            rows = faults.of(_rows, file, len(pose), names)
        counts = [len(np.atleast_1d(person[field])) for field in ("pose", "betas")]
        if counts[0] != counts[1]:
            faults.add(f"{file}: betas has {counts[1]} frames and pose {counts[0]}: they must agree")
        faults.stop()
        return pose[rows], betas.mean(0)


def _rows(file: Path, poses: int, names: list[str]) -> list[int]:
    """The row of each image's pose: the number that its name ends in, as NeuMan has it, or, with a note, its place
    among the images where the numbers fit no rows and poses are as many as images (as frames cut out of a longer video,
    or names without numbers, have it)."""
    numbers = [re.search(r"(\d+)$", Path(name).stem, re.ASCII) for name in names]
    rows = [int(number[1]) if number else -1 for number in numbers]
    outside = [name for name, row in zip(names, rows, strict=True) if not 0 <= row < poses]
    if not outside and len(set(rows)) == len(rows):
        return rows
    folder = file.parent / "images"
    there = [p.name for p in images_of(folder)] if folder.is_dir() else []
    for order in (names, there):
        if len(order) == poses and set(names) <= set(order):
            warnings.warn(
                f"{file} has poses of {poses} frames, which the numbers in the images' names, as '{names[0]}', do not "
                "count: paired in the order of the names", Note,
            )  # fmt: skip
            return [order.index(name) for name in names]
    faults = Faults(collect=True)
    faults.add_all(
        (f"{file} has poses of {poses} frames, but there is an image '{name}'" for name in outside or names),
        "images without pose",
    )
    faults.stop()
    return rows


def _frames_of(file: Path, field: str, value: Any, width: int | None) -> np.ndarray:
    """(T, width) float64, any width if None; at least one frame."""
    value = np.asarray(value)
    if value.ndim != 2 or not len(value) or (width is not None and value.shape[1] != width):
        raise UserError(f"{file}: {field} has shape {value.shape}, expected (T, {width or 10})")
    return matrix(file, field, value, value.shape, frames=True)


def _placement(
    poses: tuple[np.ndarray, np.ndarray], alignments: np.ndarray, fps: float
) -> tuple[Placement, np.ndarray]:
    """The placement in a world in metres, and each frame's scale (T,) from metres to COLMAP's scene."""
    pose, betas = poses
    linear = np.swapaxes(alignments[:, :3], 1, 2)
    scale = np.cbrt(np.linalg.det(linear))
    pivots = linear / scale[:, None, None]
    joints = pose.reshape(len(pose), -1, 3).copy()
    joints[:, 0] = axis_angle_from_matrix(pivots @ matrix_from_axis_angle(joints[:, 0]))
    motion = Motion(joints, alignments[:, 3] / scale[:, None], fps, betas.astype(np.float32), "neuman")
    return Placement(motion, "smpl", levelled(joints), pivots), scale


def _alignments(path: Path, names: list[str]) -> np.ndarray:
    """(T, 4, 3)."""
    content = load_npy(path)
    if not isinstance(content, dict):
        raise UserError(f"{path} must hold a dictionary {{image name: (4, 3)}}")

    def alignment(name: str) -> np.ndarray:
        if name not in content:
            raise UserError(f"{path} has no alignment of image '{name}'")
        value = matrix(path, name, content[name], (4, 3))
        linear = value[:3]
        scale = np.cbrt(max(np.linalg.det(linear), 0))
        if not scale > 0 or np.abs(linear @ linear.T / scale**2 - np.eye(3)).max() > 1e-2:
            raise UserError(f"{path}: {name} is no turn with one positive scale")
        return value

    faults = Faults(collect=True)
    rows = faults.each(alignment, names or sorted(map(str, content)), f"alignments of {path} are missing or faulty")
    faults.stop()
    return np.stack(rows) if rows else np.zeros((0, 4, 3))


def _colmap(folder: Path) -> dict[str, Camera]:
    """The camera of every image, by the image's name, from COLMAP's text files."""
    faults, path = Faults(collect=True), folder / "images.txt"
    lenses = faults.of(_lenses, folder / "cameras.txt")
    lines = faults.of(lambda: [line for line in _lines(path, most=9) if _names_image(line[1])])

    def image(line: tuple[int, list[str]]) -> tuple[str, Camera]:
        number, words = line
        found = Faults(collect=True)
        values = found.of(_floats, path, number, words[1:8])
        if values is not None and not np.linalg.norm(values[:4]) > 0:
            found.add(f"{path}, line {number}: the rotation's quaternion is zero")
        if lenses is not None and words[8] not in lenses:
            found.add(f"{path}, line {number}: camera {words[8]} is not in cameras.txt")
        if Path(words[9]).name != words[9] or "\0" in words[9]:
            found.add(f"{path}, line {number}: image name '{words[9]}' is not a plain name")
        found.stop()
        size, K = ((1, 1), np.eye(3)) if lenses is None else lenses[words[8]]
        T = np.c_[matrix_from_quaternion(values[:4]), values[4:]]
        return words[9], camera(path, K, T, size, shift=0.0, names=("cameras.txt", words[9]))

    if lines == []:
        faults.add(f"{path} lists no image")
    cameras = faults.each(image, lines or (), f"lines of {path} are faulty")
    faults.stop()
    return dict(cameras)


def _lenses(path: Path) -> dict[str, tuple[tuple[int, int], np.ndarray]]:
    """Size and matrix of every camera of cameras.txt, by its number."""

    def lens(line: tuple[int, list[str]]) -> tuple[str, tuple]:
        number, words = line
        model = words[1] if len(words) > 1 else ""
        count, focal = MODELS.get(model, (0, 1))
        if not count or len(words) < 4 + count:
            raise UserError(
                f"{path}, line {number}: expected ID MODEL WIDTH HEIGHT PARAMETERS of {', '.join(MODELS)}"
                + (
                    f"; images of {model} are to be straightened by `colmap image_undistorter` first"
                    if words[1:]
                    else ""
                )
            )
        values = _floats(path, number, words[2 : 4 + count])
        if not (values[:2] >= 1).all() or not (values[:2] < 1e6).all():
            raise UserError(f"{path}, line {number}: width and height must be positive, not {words[2]} and {words[3]}")
        fx, fy, (cx, cy) = values[2], values[1 + focal], values[2 + focal : 4 + focal]
        size, K = (int(values[0]), int(values[1])), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        _note_distortion(f"{path}, line {number}", model, size, K, values[4 + focal :])
        return words[0], (size, K)

    faults = Faults(collect=True)
    lenses = faults.each(lens, list(_lines(path)), f"lines of {path} are faulty")
    faults.stop()
    return dict(lenses)


def _note_distortion(where: str, model: str, size: tuple[int, int], K: np.ndarray, distortion: np.ndarray) -> None:
    """A note where lens distortion, which is left out, moves a corner of the image by more than a pixel."""
    coefficients = np.zeros(8)
    coefficients[: len(distortion)] = distortion
    corners = np.array([(x, y) for x in (0, size[0]) for y in (0, size[1])], np.float64)
    if not np.any(distortion) or not (K[[0, 1], [0, 1]] > 0).all():
        return
    rays = np.c_[(corners - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones(4)]
    moved, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, coefficients)
    most = np.linalg.norm(moved[:, 0] - corners, axis=-1).max()
    if most > 1:
        warnings.warn(
            f"{where}: the lens distortion of {model} moves the image's corners by {most:.0f} pixels and is left out, "
            "as NeuMan does: straighten the images by `colmap image_undistorter` where that is too much", Note,
        )  # fmt: skip


def _names_image(words: list[str]) -> bool:
    """Whether a line of images.txt is that of an image; the others are the points of the image before."""
    return len(words) == 10 and words[9].lower().endswith(IMAGES)


def _lines(path: Path, most: int = -1) -> Iterator[tuple[int, list[str]]]:
    """Number and words of each line that is not a comment. most: splits, so that the last word may hold blanks."""
    if not path.is_file():
        binary = path.with_suffix(".bin").is_file()
        hint = f" (`colmap model_converter --output_type TXT` makes it of {path.stem}.bin)" if binary else ""
        raise UserError(f"{path} is missing: COLMAP's text model{hint}")
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        if line.strip() and not line.startswith("#"):
            yield number, line.strip().split(maxsplit=most)


def _floats(path: Path, number: int, words: list[str]) -> np.ndarray:
    try:
        values = np.array([float(w) for w in words])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise UserError(f"{path}, line {number}: a number is malformed")
    return values


def _splits(path: Path, names: list[str]) -> dict[str, list[View]]:
    frame = {name: f for f, name in enumerate(names)}
    splits, faults = {}, Faults(collect=True)
    for split in SPLITS:
        file = path / f"{split}_split.txt"
        if file.is_file():
            listed = [line.strip() for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
            faults.add_all(
                (f"{file} names image '{name}', which sparse/images.txt lacks" for name in listed if name not in frame),
                f"images of {file}",
            )
            splits[split] = [View(CAM, frame[name]) for name in listed if name in frame]
    faults.stop()
    if splits.get("train"):
        return splits
    count = len(names) // 5
    if count < 2:
        return {"train": [View(CAM, f) for f in range(len(names))]}
    step = int(1 / count * len(names))  # in this order, as data_io/neuman_helper.py rounds: 1245 images are 4 apart
    held = list(range(len(names)))[step // 2 :: step]
    parts = {"train": [f for f in range(len(names)) if f not in held], "test": held[: len(held) // 2]}
    parts["val"] = held[len(held) // 2 :]
    return {split: [View(CAM, f) for f in frames] for split, frames in parts.items()}


def _mask_path(folder: Path, name: str) -> Path:
    """NAME.npy where it lies, as NeuMan's reader has it, else the image NAME."""
    return array if (array := folder / f"{name}.npy").is_file() else folder / name


def _mask(path: Path) -> np.ndarray:
    """(H, W) uint8 alpha: the file is 255, or 1 where nothing is more, where the person is not."""
    labels = npy_mask(path) if path.suffix == ".npy" else read_image(path, cv2.IMREAD_GRAYSCALE)
    not_person = 1 if labels.size and labels.max() == 1 else 255
    return np.where(labels == not_person, 0, 255).astype(np.uint8)
