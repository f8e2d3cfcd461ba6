"""Reading videos frame by frame: turned as the phone was held, counted by decoding."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")
COUNT_UP_TO = 6000  # frames; a longer video's own word is taken for its length


@dataclasses.dataclass(frozen=True)
class VideoFacts:
    """count: frames. rate: frames per second or None. size: (width, height) upright, as frames are decoded."""

    count: int
    rate: float | None
    size: tuple[int, int]


def _open(path: Path) -> cv2.VideoCapture:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # its complaints are not for a user
    video = cv2.VideoCapture(str(path))
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)  # phones store sideways pictures and a note to turn them
    return video


def video_facts(path: Path) -> VideoFacts:
    """Raises UserError when the file cannot be decoded. The frame count in a container is a guess: it is checked."""
    video = _open(path)
    try:
        said, rate = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), video.get(cv2.CAP_PROP_FPS)
        ok, first = video.read()
        if not ok:
            raise UserError(f"{path} cannot be read as a video: it is damaged or its codec is unknown to OpenCV")
        count = 1
        while count <= COUNT_UP_TO and video.grab():
            count += 1
        if count > COUNT_UP_TO:
            count = max(said, count)
    finally:
        video.release()
    return VideoFacts(count, rate if rate and np.isfinite(rate) and 0 < rate < 10000 else None, first.shape[1::-1])


def video_frames(path: Path, numbers: np.ndarray) -> Iterator[np.ndarray]:
    """(H, W, 3) uint8 BGR. Decoded in order from the start: seeking in compressed video is not exact. `numbers` must
    increase."""
    video = _open(path)
    try:
        wanted = iter(numbers)
        target = next(wanted)
        for k in range(int(numbers[-1]) + 1):
            if not video.grab():
                raise UserError(f"{path} ends at frame {k}, but frame {numbers[-1]} was asked for: it is damaged")
            if k == target:
                ok, image = video.retrieve()
                if not ok:
                    raise UserError(f"{path}: frame {k} cannot be decoded: the file is damaged")
                yield image
                target = next(wanted, None)
    finally:
        video.release()
