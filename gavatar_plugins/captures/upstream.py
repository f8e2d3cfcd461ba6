"""Captures of the authors' released GaussianAvatar code."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from gavatar.capture.capture import Capture, View
from gavatar.capture.placement import Placement, upright
from gavatar.capture.reading import IMAGES, arrays, camera, image_mask, image_size, images_of, paired, person_masks
from gavatar.protocols import CaptureReader
from gavatar.registry import CAPTURES
from gavatar_runtime.errors import Faults, UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion, joined


@dataclasses.dataclass
class UpstreamOptions:
    """parameters: the file of poses in train/ and test/; smpl_parms_pred.pth is what upstream's first stage refined.
    fps: of the video, the files do not say."""

    parameters: str = "smpl_parms.pth"
    fps: float = 30.0


@CAPTURES.register(
    "upstream", config=UpstreamOptions, summary="GaussianAvatar's own: train|test/, smpl_parms.pth, cam_parms"
)
class UpstreamCapture(CaptureReader):
    """train/ and, if there, test/, each with images/, masks/ (same names), smpl_parms.pth: beta (1, 10), body_pose
    (T, 72) of SMPL or (T, 165) of SMPL-X with the root first, trans (T, 3), rows in the order of the images' names; and
    cam_parms.npz, or cam_parms/NAME.npz for a camera that moves: intrinsic 3x3, extrinsic 4x4 world to camera; pixel
    positions count from the image's corner."""

    signs = "train/smpl_parms.pth"

    def __init__(self, config: UpstreamOptions):
        self.config = config

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether the folder looks like this layout."""
        return any((path / "train").glob("smpl_parms*.pth"))

    def read(self, path: Path, faults: Faults | None = None) -> Capture:
        """Open the capture; UserError when malformed, after all faults were collected if `faults` does."""
        path, faults = Path(path), faults or Faults()
        parts: dict[str, _Part] = {}
        for split in ("train", "test"):
            if split == "train" or (path / split).is_dir():
                part = self._part(path / split, faults)
                if part is not None:
                    parts[split] = part
        faults.stop()
        motion, splits, images, masks = _joined(parts)
        placement = Placement(motion, "smplx" if motion.poses.shape[1] == 55 else "smpl", upright(motion.poses))
        first = {split: sum(len(p.images) for p in list(parts.values())[:i]) for i, split in enumerate(parts)}
        moving = {
            View(split, first[split] + i): placement.camera(c)
            for split, part in parts.items()
            for i, c in enumerate(part.cameras)
        }
        return Capture(
            path=path,
            name=path.resolve().name,
            license="unknown",
            source="GaussianAvatar's processing",
            body_model=placement.family,
            background="footage",
            cameras={split: moving[View(split, first[split])] for split in parts},
            splits=splits,
            motion=placement.motion(),
            truth=None,
            image_path=lambda view: images[view.frame],
            mask_path=lambda view: masks[view.frame],
            read_mask=person_masks(masks, image_mask),
            moving=moving,
            listing="images",
            placement=placement,
        )

    def _part(self, folder: Path, faults: Faults) -> _Part | None:
        images = faults.of(images_of, folder / "images")
        motion = faults.of(read_motion, folder / self.config.parameters, up="y", fps=self.config.fps)
        if images is not None and motion is not None:
            motion = faults.of(paired, folder / self.config.parameters, motion, len(images))
            images = images[: len(motion)] if motion is not None else images
        cameras = faults.of(_cameras, folder, images) if images else None
        masks = faults.of(_masks, folder, images) if images else None
        if motion is not None and motion.betas is None:
            faults.add(f"{folder / self.config.parameters}: field 'beta' is missing")
        if images is None or motion is None or cameras is None or masks is None:
            return None
        return _Part(images, masks, cameras, motion)


@dataclasses.dataclass
class _Part:
    images: list[Path]
    masks: list[Path]
    cameras: list[Camera]
    motion: Motion


def _joined(parts: dict[str, _Part]) -> tuple[Motion, dict[str, list[View]], list[Path], list[Path]]:
    """One motion of both parts, the splits, and the images and masks by frame."""
    counts = [len(part.images) for part in parts.values()]
    motions = [part.motion for part in parts.values()]
    widths = {m.poses.shape[1] for m in motions}
    if len(widths) > 1:
        raise UserError(
            f"train and test have poses of {' and '.join(map(str, sorted(widths)))} joints: they must agree"
        )
    motion = joined([motion.taken(slice(count)) for motion, count in zip(motions, counts, strict=True)])
    splits, start = {}, 0
    for split, count in zip(parts, counts, strict=True):
        splits[split] = [View(split, f) for f in range(start, start + count)]
        start += count
    return motion, splits, [i for p in parts.values() for i in p.images], [m for p in parts.values() for m in p.masks]


def _cameras(folder: Path, images: list[Path]) -> list[Camera]:
    """One a frame."""
    size = image_size(images[0])

    def read(path: Path) -> Camera:
        values = arrays(path, "intrinsic", "extrinsic")
        return camera(path, values["intrinsic"], values["extrinsic"], size, shift=0.0)

    static = folder / "cam_parms.npz"
    if static.is_file():
        return [read(static)] * len(images)
    if not (folder / "cam_parms").is_dir():
        raise UserError(f"{static} is missing, and so is {folder / 'cam_parms'}/ of a moving camera")
    faults = Faults(collect=True)
    files = [folder / "cam_parms" / f"{_base(image)}.npz" for image in images]
    cameras = faults.each(read, files, f"files of {folder / 'cam_parms'} are faulty")
    faults.stop()
    return cameras


def _masks(folder: Path, images: list[Path]) -> list[Path]:
    """The mask of each image, by its name; the path that should be there for one that is not."""
    found = {_base(p): p for p in images_of(folder / "masks", IMAGES)}
    return [found.get(_base(image), folder / "masks" / f"{_base(image)}.png") for image in images]


def _base(path: Path) -> str:
    """What upstream calls a frame by: its image's name to the first dot."""
    return path.name.split(".")[0]
