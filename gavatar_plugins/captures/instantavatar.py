"""Captures as InstantAvatar (Jiang et al. 2023) processes them: People-Snapshot, and NeuMan and other phone videos."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from gavatar.capture.capture import Capture, View
from gavatar.capture.placement import Placement, upright
from gavatar.capture.reading import (
    arrays,
    camera,
    every_tenth,
    image_mask,
    images_of,
    matrix,
    npy_mask,
    paired,
    person_masks,
)
from gavatar.protocols import CaptureReader
from gavatar.registry import CAPTURES
from gavatar_runtime.errors import Faults, UserError, frames_named
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

CAM = "cam0"
# First, last and step of train, val and test: InstantAvatar's confs/dataset/{peoplesnapshot,neuman}, ends included
PUBLISHED = {
    "female-3-casual": ((0, 445, 4), (446, 446, 4), (446, 647, 4)),
    "female-4-casual": ((0, 335, 4), (335, 335, 4), (335, 523, 4)),
    "female-4-sport": ((1, 336, 4), (336, 336, 8), (336, 524, 4)),
    "male-2-casual": ((1, 455, 4), (455, 455, 8), (1, 455, 20)),
    "male-2-sport": ((1, 455, 4), (455, 455, 8), (1, 455, 20)),
    "male-3-casual": ((0, 455, 4), (456, 456, 4), (456, 675, 4)),
    "male-3-sport": ((1, 230, 2), (230, 230, 6), (230, 460, 6)),
    "male-4-casual": ((0, 659, 6), (660, 660, 6), (660, 872, 6)),
    "seattle": ((0, 41, 1), (40, 41, 4), (40, 41, 4)),
}
SPLITS = ("train", "val", "test")


@dataclasses.dataclass
class InstantAvatarOptions:
    """sequence: whose published splits to take (male-3-casual, seattle, ...), by default the folder's name; else
    every tenth frame is put aside. refined_poses: read poses/anim_nerf_SPLIT.npz or poses/SPLIT.npz where they lie.
    fps: of the video, the files do not say."""

    sequence: str = ""
    refined_poses: bool = True
    fps: float = 30.0


@CAPTURES.register(
    "instantavatar",
    config=InstantAvatarOptions,
    summary="InstantAvatar's People-Snapshot and NeuMan: cameras.npz",
)
class InstantAvatarCapture(CaptureReader):
    """cameras.npz: intrinsic 3x3 and extrinsic 4x4 (world to camera), height, width; pixel positions count from pixel
    centres. images/*.png, masks/*.npy (0, 1) or *.png, paired in the order of their names. poses.npz or
    poses_optimized.npz: betas (10), thetas (T, 72) or global_orient and body_pose, transl (T, 3), SMPL, in the axes of
    a camera; poses/anim_nerf_SPLIT.npz or poses/SPLIT.npz: refined, a row for each frame of that split."""

    signs = "cameras.npz and images/"

    def __init__(self, config: InstantAvatarOptions):
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether the folder looks like this layout."""
        return (path / "cameras.npz").is_file() and (path / "images").is_dir()

    def read(self, path: Path, faults: Faults | None = None) -> Capture:
        """Open the capture; UserError when malformed, after all faults were collected if `faults` does."""
        path, faults = Path(path), faults or Faults()
        cam = faults.of(_camera, path / "cameras.npz")
        images = faults.of(images_of, path / "images")
        masks = faults.of(_masks, path / "masks")
        if images and masks and len(images) != len(masks):
            faults.add(f"{path / 'masks'} holds {len(masks)} masks, but {path / 'images'} holds {len(images)} images")
        whole = faults.of(self._whole, path, len(images) if images else None)
        frames = len(whole) if whole is not None else len(images or ())
        splits: Any = faults.of(self._splits, path, frames) if images else None
        motion: Any = faults.of(self._motion, path, splits, frames, whole) if splits else None
        faults.stop()
        placement = Placement(motion, "smpl", upright(motion.poses))
        return Capture(
            path=path,
            name=path.resolve().name,
            license="unknown",
            source="InstantAvatar's processing",
            body_model="smpl",
            gender=self._gender(path),
            background="footage",
            cameras={CAM: placement.camera(cam)},
            splits=splits,
            motion=placement.motion(),
            truth=None,
            image_path=lambda view: images[view.frame],
            mask_path=lambda view: masks[view.frame],
            read_mask=person_masks(masks, lambda mask: npy_mask(mask) if mask.suffix == ".npy" else image_mask(mask)),
            listing="images",
            placement=placement,
        )

    def _gender(self, path: Path) -> str:
        """Of the body model that the poses were made with: People-Snapshot's sequences are named by it."""
        first = (self.config.sequence or path.resolve().name).split("-")[0]
        return first if first in ("male", "female") else "neutral"

    def _splits(self, path: Path, frames: int) -> dict[str, list[View]]:
        name = self.config.sequence or path.resolve().name
        if name not in PUBLISHED:
            if self.config.sequence:
                raise UserError(f"sequence={name} has no published splits; those that have: {', '.join(PUBLISHED)}")
            return every_tenth(frames, CAM)
        splits = {
            split: [View(CAM, f) for f in range(first, min(last + 1, frames), step)]
            for split, (first, last, step) in zip(SPLITS, PUBLISHED[name], strict=True)
        }
        empty = [split for split in ("train", "test") if not splits[split]]
        if empty:
            raise UserError(f"{path / 'images'} holds {frames} images: none is left for split '{empty[0]}' of {name}")
        return splits

    def _motion(self, path: Path, splits: dict[str, list[View]], frames: int, whole: Motion | None) -> Motion:
        refined = self._refined(path, splits) if self.config.refined_poses else {}
        if whole is None and _whole_file(path) is not None:
            raise UserError()  # its faults are told already
        motion = _between(refined, splits, frames, path, self.config.fps) if whole is None else whole
        poses, trans, betas = motion.poses.copy(), motion.trans.copy(), motion.betas
        for split in reversed(SPLITS):  # of a frame in two splits the training's pose counts
            if split in refined:
                rows = [view.frame for view in splits[split]]
                poses[rows], trans[rows] = refined[split].poses, refined[split].trans
                betas = refined[split].betas
        if betas is None:
            raise UserError(f"{_whole_file(path) or path / 'poses'}: field 'betas' is missing")
        return dataclasses.replace(motion, poses=poses, trans=trans, betas=betas)

    def _whole(self, path: Path, images: int | None) -> Motion | None:
        """The poses of all frames, of those that have an image; None where they do not lie there."""
        file = _whole_file(path)
        if file is None:
            return None
        motion = read_motion(file, up="y", fps=self.config.fps)
        return motion if images is None else paired(file, motion, images)

    def _refined(self, path: Path, splits: dict[str, list[View]]) -> dict[str, Motion]:
        found, faults = {}, Faults(collect=True)
        for split in SPLITS:
            names = (f"poses/anim_nerf_{split}.npz", f"poses/{split}.npz")
            file = next((path / n for n in names if (path / n).is_file()), None)
            if file is None or not splits.get(split):
                continue
            motion = faults.of(read_motion, file, up="y", fps=self.config.fps)
            if motion is None:
                continue
            if len(motion) < len(splits[split]):
                faults.add(f"{file} has poses of {len(motion)} frames, but split '{split}' has {len(splits[split])}")
            # InstantAvatar takes the first rows, one for each image, of files that hold more
            found[split] = motion.taken(slice(len(splits[split])))
        faults.stop()
        return found


def _masks(folder: Path) -> list[Path]:
    """People-Snapshot's reader takes masks/*.npy alone, the one for phone videos *.png: of both, the arrays count."""
    arrays = folder.is_dir() and any(p.suffix == ".npy" for p in folder.iterdir())
    return images_of(folder, (".npy",) if arrays else (".npy", ".png"))


def _whole_file(path: Path) -> Path | None:
    """The poses of all frames, where they lie."""
    return next((p for n in ("poses_optimized.npz", "poses.npz") if (p := path / n).is_file()), None)


def _between(refined: dict[str, Motion], splits: dict[str, list[View]], frames: int, path: Path, fps: float) -> Motion:
    """Poses for all frames where only those of the splits are known: the others, which nobody looks at, repeat them."""
    rows = {v.frame: (m.poses[i], m.trans[i]) for s, m in refined.items() for i, v in enumerate(splits[s])}
    if not rows:
        raise UserError(f"{path / 'poses.npz'} is missing, and so is poses_optimized.npz")
    owed = {view.frame for views in splits.values() for view in views if view.frame not in rows}
    if owed:
        raise UserError(f"{path / 'poses.npz'} is missing, and poses/ has no pose of {frames_named(owed)}")
    known = np.array(sorted(rows))
    nearest = known[np.clip(np.searchsorted(known, np.arange(frames)), 0, len(known) - 1)]
    return Motion(np.stack([rows[f][0] for f in nearest]), np.stack([rows[f][1] for f in nearest]), fps, None)


def _camera(path: Path) -> Camera:
    values = arrays(path, "intrinsic", "extrinsic", "height", "width")
    faults = Faults(collect=True)
    width, height = (faults.of(_pixels, path, key, values[key]) for key in ("width", "height"))
    made = faults.of(camera, path, values["intrinsic"], values["extrinsic"], (width or 1, height or 1), shift=0.5)
    faults.stop()
    return made


def _pixels(path: Path, key: str, value: np.ndarray) -> int:
    pixels = int(matrix(path, key, value, ()))
    if pixels < 1:
        raise UserError(f"{path}: {key} must be positive, not {pixels}")
    return pixels
