"""What the readers of other people's captures share: arrays, matrices and image lists, checked and named."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gavatar_runtime.errors import Faults, UserError, frames_named
from gavatar_runtime.formats.numpy_file import load_npy, load_npz
from gavatar_runtime.notes import Note
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

from .capture import View, read_gray, read_image

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".webp")


def arrays(path: Path, *keys: str) -> dict[str, Any]:
    """The arrays of an .npz; UserError when it is missing, damaged or lacks one of `keys`."""
    if not path.is_file():
        raise UserError(f"{path} is missing")
    found = load_npz(path)
    require(path, found, keys)
    return found


def require(path: Path, found: dict, keys: tuple[str, ...], where: str = "") -> None:
    """UserError naming every one of `keys` that a dictionary of fields lacks. where: of the fields within the file."""
    have = f" (it has: {', '.join(sorted(map(str, found))) or 'none'})"
    missing = [f"{path}: {where}field '{key}' is missing{have}" for key in keys if key not in found]
    if missing:
        raise UserError(*missing)


def matrix(path: Path, field: str, value: Any, *shapes: tuple[int, ...], frames: bool = False) -> np.ndarray:
    """A finite float64 array of one of `shapes`, a single 1 in front allowed; UserError naming file and field.
    frames: its rows are frames, and those at fault are named."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise UserError(f"{path}: {field} holds {array.dtype} values, expected numbers")
    array = array.astype(np.float64)
    if array.ndim and array.shape[0] == 1 and array.shape not in shapes and array.shape[1:] in shapes:
        array = array[0]
    if array.shape not in shapes:
        wanted = " or ".join("x".join(map(str, s)) for s in shapes)
        raise UserError(f"{path}: {field} has shape {array.shape}, expected {wanted}")
    finite = np.isfinite(array)
    if not finite.all():
        where = f" at {frames_named(np.flatnonzero(~finite.all(tuple(range(1, array.ndim)))))}" if frames else ""
        raise UserError(f"{path}: {field} holds NaN or infinite values{where}")
    return array


def pose_field(path: Path, name: str, content: dict, shape: tuple[int, ...]) -> np.ndarray:
    """A field of one frame's parameters, of `shape` however it is nested; UserError naming file and field."""
    value = np.asarray(content[name])
    return matrix(path, name, value.reshape(-1) if value.size == np.prod(shape) else value, shape)


def camera(
    path: Path,
    K: Any,
    T: Any,
    size: tuple[int, int],
    *,
    shift: float,
    names: tuple[str, str] = ("intrinsic", "extrinsic"),
) -> Camera:
    """A camera from a 3x3 intrinsic and a 3x4 or 4x4 world-to-camera matrix.

    size: width, height. shift: pixels added to the principal point: 0.5 where the data set counts from pixel centres
    (OpenCV), 0 where it counts from the image's corner. names: of the two fields, for messages.
    Raises UserError, of both where both are at fault.
    """
    faults = Faults(collect=True)
    K, world_to_camera = faults.of(_intrinsic, path, names[0], K), faults.of(_extrinsic, path, names[1], T)
    faults.stop()
    width, height = size
    return Camera(width, height, K[0, 0], K[1, 1], K[0, 2] + shift, K[1, 2] + shift, world_to_camera)


def _intrinsic(path: Path, name: str, K: Any) -> np.ndarray:
    K = matrix(path, name, K, (3, 3), (4, 4))
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise UserError(f"{path}: {name}: focal lengths must be positive, not {K[0, 0]:g} and {K[1, 1]:g}")
    if abs(K[0, 1]) > 1e-3 * K[0, 0]:
        raise UserError(f"{path}: {name} has a skew of {K[0, 1]:g}: only upright pixels are read")
    return K


def _extrinsic(path: Path, name: str, T: Any) -> np.ndarray:
    T = matrix(path, name, T, (4, 4), (3, 4))
    world_to_camera = np.eye(4)
    world_to_camera[:3] = T[:3]
    R = world_to_camera[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise UserError(f"{path}: {name} is no rigid motion: its first three columns are not a rotation")
    U, _, Vt = np.linalg.svd(R)  # calibration files round: the nearest rotation
    world_to_camera[:3, :3] = U @ Vt
    return world_to_camera


def images_of(folder: Path, suffixes: tuple[str, ...] = IMAGES) -> list[Path]:
    """The files of a folder with one of the suffixes, by name; UserError when there is none."""
    if not folder.is_dir():
        raise UserError(f"{folder} is missing")
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() in suffixes and not p.name.startswith("."))
    if not found:
        raise UserError(f"{folder} holds no file of {', '.join(suffixes)}")
    return found


def image_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels."""
    return read_image(path, cv2.IMREAD_COLOR).shape[1::-1]


def paired(path: Path, motion: Motion, images: int) -> Motion:
    """The poses of as many frames as there are images, in their order: what is too many is cut, with a note. Fewer by
    one, or by a fiftieth of a long sequence, are noted too, the images at the end then have no pose and are to be left
    out; of fewer still UserError."""
    lack = images - len(motion)
    if lack > 1 + images // 50:
        raise UserError(f"{path} has poses of {len(motion)} frames, but there are {images} images")
    if lack:
        rest = f"the last {abs(lack)} {'images' if lack > 0 else 'poses'} are left out" if abs(lack) > 1 else (
            f"the last {'image' if lack > 0 else 'pose'} is left out")  # fmt: skip
        warnings.warn(f"{path} has poses of {len(motion)} frames, but there are {images} images: {rest}", Note)
    return motion.taken(slice(images))


def with_images(
    listing: Path, splits: dict[str, list[View]], image_path: Callable[[View], Path]
) -> dict[str, list[View]]:
    """The splits without the views whose image is not there, which a note names: people copy a part of a data set.

    listing: the file that lists the images. Raises UserError when most are missing, or all of a split for training.
    """
    views = dict.fromkeys(view for part in splits.values() for view in part)
    missing = {view: image_path(view) for view in views if not image_path(view).is_file()}
    if not missing:
        return splits
    left = {split: [view for view in part if view not in missing] for split, part in splits.items()}
    if 2 * len(missing) > len(views) or not left.get("train"):
        raise UserError(
            f"{listing} lists {len(views)} images of which {len(missing)} are missing, the first "
            f"{next(iter(missing.values()))}: copy the whole capture"
        )
    cameras: dict[str, list[int]] = {}
    for view in missing:
        cameras.setdefault(view.camera, []).append(view.frame)
    named = "; ".join(f"of camera {name} {frames_named(frames)}" for name, frames in cameras.items())
    warnings.warn(f"{listing} lists images that are missing and are left out: {named}", Note)
    return {split: part for split, part in left.items() if part}


def person_masks(
    masks: Sequence[Path], read: Callable[[Path], np.ndarray], published: str = "0"
) -> Callable[[Path], np.ndarray]:
    """`read`, or its inverse with a note, where the masks show by their border that they are the wrong way round: the
    person covers most of it in most of a sample. published: the value that is not the person by the layout's rule."""
    shares = []
    for i in np.unique(np.linspace(0, max(0, len(masks) - 1), 7).astype(int))[: len(masks)]:
        try:
            alpha = read(masks[i])
        except UserError:  # a fault of its own, told elsewhere
            continue
        border = np.concatenate([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]]) if alpha.size else np.zeros(1)
        if (alpha < 128).any():
            shares.append((border > 127).mean())
    if not shares or np.median(shares) <= 0.5:
        return read
    warnings.warn(
        f"{masks[0].parent}: the masks' border is the person, if {published} is not: taken the other way round", Note
    )
    return lambda path: 255 - read(path)


def every_tenth(frames: int, camera: str) -> dict[str, list[View]]:
    """Splits of a sequence without published ones: every tenth frame is for testing, from the sixth on."""
    test = range(5, frames, 10)
    return {
        "train": [View(camera, f) for f in range(frames) if f not in test],
        "test": [View(camera, f) for f in test],
    }


def image_mask(path: Path) -> np.ndarray:
    """(H, W) uint8 alpha from an image of 0 to 255, or of 0 and 1."""
    mask = read_gray(path)
    return mask * np.uint8(255) if mask.max() == 1 else mask


def npy_mask(path: Path) -> np.ndarray:
    """(H, W) uint8 alpha from an .npy of 0 and 1, of booleans, or of 0 to 255."""
    if not path.is_file():
        raise UserError(f"{path} is missing")
    array = np.asarray(load_npy(path))
    if array.ndim == 3 and 1 in (array.shape[0], array.shape[2]):
        array = array[..., 0] if array.shape[2] == 1 else array[0]
    if array.ndim != 2 or array.dtype.kind not in "biuf":
        raise UserError(f"{path} is not a plain .npy mask (H, W): it has shape {array.shape} of {array.dtype}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise UserError(f"{path} holds NaN or infinite values")
    top = 1 if array.dtype.kind == "b" or not array.size or array.max() <= 1 else 255
    return np.round(np.clip(array.astype(np.float32), 0, top) * (255 / top)).astype(np.uint8)
