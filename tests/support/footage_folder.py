"""Footage of the demo capture as people lay it out: frames, masks and landmarks in a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from demo_pictures import picture, true_mask

SIDE = 64  # pixels of the frames: nothing here is fitted


def frame(t: int) -> np.ndarray:
    """(SIDE, SIDE, 3) uint8 BGR."""
    return cv2.resize(picture(t), (SIDE, SIDE), interpolation=cv2.INTER_AREA)


def mask(t: int) -> np.ndarray:
    """(SIDE, SIDE) uint8, 0 and 255."""
    return cv2.resize(255 * true_mask(t).astype(np.uint8), (SIDE, SIDE), interpolation=cv2.INTER_NEAREST)


def footage_folder(
    folder: Path,
    frame_names: list[str],
    mask_names: list[str],
    as_stored: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda mask, frame: mask,
) -> Path:
    """as_stored: the picture that is written for a mask (SIDE, SIDE) and its frame."""
    for part in ("frames", "masks"):
        (folder / part).mkdir(parents=True)
    for t, name in enumerate(frame_names):
        cv2.imwrite(str(folder / "frames" / name), frame(t))
    for t, name in enumerate(mask_names):
        cv2.imwrite(str(folder / "masks" / name), as_stored(mask(t), frame(t)))
    write_landmarks(folder / "landmarks.npz", len(frame_names))
    return folder


def write_landmarks(path: Path, count: int) -> Path:
    """Any points inside the picture, the first one's x the number of its frame."""
    points = np.random.default_rng(0).uniform(10, 50, (count, 33, 4)).astype(np.float32)
    points[..., 3] = 0.9
    points[:, 0, 0] = np.arange(count) + 3
    np.savez(path, image=points, world=points, fps=10.0)
    return path
