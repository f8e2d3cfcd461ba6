"""Landmarks and masks for footage that has none, and what to tell the user about it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError

from ..capture.capture import read_gray
from .footage.shots import Wardrobe
from .handheld.room_motion import RoomMotion, measure_room_motion
from .hands.hand_network import HandNetworks
from .landmarks import Landmarks
from .plate.mending import MaskMaker
from .pose_network import PoseNetworks
from .steadiness import STEADY, Steadiness
from .track import Tracked, track

TRAVELS = 0.004  # of the picture's longer side: by more a room does not miss how a turning camera sees it


@dataclasses.dataclass(frozen=True)
class Detection:
    """landmarks: of the chosen frames, filmed pixels. mask_files: one per chosen frame. notes: sentences for the
    user. changes: indices of the chosen frames with which another person is followed. background: (H, W, 3) uint8 BGR,
    the room without the person, filmed pixels, None where it is not known. motion: of the room in the picture, where
    the camera moves and the room says how."""

    landmarks: Landmarks
    mask_files: list[Path]
    notes: list[str]
    changes: list[int]
    background: np.ndarray | None = None
    motion: RoomMotion | None = None


class Detector:
    """Finds the person in one camera's footage after the other and keeps the masks in `folder`.

    network: another landmark network. background: a picture of the room without anybody, of the only camera. matting: a
    network of the user's that makes the masks.
    """

    def __init__(self, folder: Path, network: Path | None = None, progress: bool = True, *,
                 background: Path | None = None, matting: Path | None = None):  # fmt: skip
        self.folder, self.progress = folder, progress
        self.networks, self.hands = PoseNetworks(network), HandNetworks()
        self.masks = MaskMaker(background, matting, progress)

    def __call__(
        self, name: str, images: Callable[[], Iterable[np.ndarray]], numbers: np.ndarray, fps: float | None
    ) -> Detection:
        """images: gives the chosen frames, numbered `numbers` in the source, each time it is called. Raises UserError
        when nobody is found."""
        folder = self.folder / name
        folder.mkdir(parents=True, exist_ok=True)
        files = [folder / f"{number:06d}.png" for number in numbers]
        steadiness, wardrobe = Steadiness(), Wardrobe()

        def watch(image: np.ndarray, mask: np.ndarray) -> None:
            steadiness.add(image, mask)
            wardrobe.add(image, mask)

        def write(t: int, mask: np.ndarray) -> None:
            if not cv2.imwrite(str(files[t]), mask):
                raise UserError(f"{files[t]} could not be written: is the disk full?")

        tracked = track(images, len(numbers), write, self.networks, f"'{name}'", fps, self.progress, watch, self.hands)
        motion = None
        if steadiness.moved is not None and steadiness.moved > STEADY:
            motion = measure_room_motion(images(), (read_gray(file) for file in files))
        said = notes(name, numbers, tracked, steadiness.moved, motion)
        made = self.masks(name, images, files, steadiness.moved)
        return Detection(tracked.landmarks, files, said + made.notes, wardrobe.changes(), made.background, motion)


def notes(
    name: str, numbers: np.ndarray, tracked: Tracked, moved: float | None, motion: RoomMotion | None = None
) -> list[str]:
    """What a user should know of the footage of camera `name`, one sentence each, the worst first."""
    said = []
    missing = ~(tracked.landmarks.visibility > 0).any(1)
    if moved is not None and moved > STEADY:
        by = f"{name}: the camera moves (the background by {100 * moved:.1f} % of the picture)"
        if motion is None:
            said.append(f"{by}, but too little of the room is seen to say how: put it on something")
        elif motion.miss > TRAVELS:
            said.append(f"{by} and travels through the room: it is taken for one that turns, so that places are rough")
        else:
            said.append(f"{by}: how it turns and zooms is measured, and the body fitted in a room that stands still")
    if tracked.people > 1:
        said.append(f"{name}: {tracked.people} people are in the picture; the largest is followed")
    if missing.any():
        said.append(f"{name}: nobody is found in {_frames(numbers[missing], len(numbers))}; those are bridged")
    sides = [side for side, cut in zip(("left", "top", "right", "bottom"), tracked.cut.T, strict=True)
             if cut.mean() > 0.05]  # fmt: skip
    if sides:
        share = tracked.cut.any(1)
        said.append(
            f"{name}: the person is cut off at the {' and '.join(sides)} edge of the picture in "
            f"{_frames(numbers[share], len(numbers))}: what is outside cannot be learnt"
        )
    known = np.isfinite(tracked.sharpness)
    if known.sum() >= 5:
        typical = np.median(tracked.sharpness[known])
        blurred = known & (np.nan_to_num(tracked.sharpness) < 0.35 * typical)
        if blurred.any():
            said.append(f"{name}: {_frames(numbers[blurred], len(numbers))} blurred beside the others: leave them "
                        "out with `frames`, or move more slowly")  # fmt: skip
    return said


def _frames(chosen: np.ndarray, count: int) -> str:
    few = ", ".join(str(n) for n in chosen[:6]) + (", ..." if len(chosen) > 6 else "")
    return f"{len(chosen)} of {count} frames ({few})"
