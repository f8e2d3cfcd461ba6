"""Reading videos frame by frame: turned as the phone was held, counted by decoding, by OpenCV or else by a program
ffmpeg."""

from __future__ import annotations

import dataclasses
import os
import shlex
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError

from .container import codec_name, high_dynamic_range
from .ffmpeg_program import program, program_facts, program_frames

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")
COUNT_UP_TO = 6000  # frames; a longer video's own word is taken for its length


@dataclasses.dataclass(frozen=True)
class VideoFacts:
    """count: frames. rate: frames per second that the file says, or None. size: (width, height) upright, as frames are
    decoded. stamps: (count,) seconds at which they are shown, None where not all were decoded. notes: sentences."""

    count: int
    rate: float | None
    size: tuple[int, int]
    stamps: np.ndarray | None = None
    notes: tuple[str, ...] = ()


def _open(path: Path) -> cv2.VideoCapture:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # its complaints are not for a user
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        # whole path: the start of a:b.mp4 would be a protocol; FFmpeg: others take %d for a row of pictures
        video = cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)
        if not video.isOpened():
            video = cv2.VideoCapture(str(path.absolute()))
    except UnicodeEncodeError:
        raise UserError(f"{path} has a name that is no text to OpenCV: rename it") from None
    finally:
        cv2.utils.logging.setLogLevel(level)
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)  # phones store sideways pictures and a note to turn them
    return video


def video_facts(path: Path) -> VideoFacts:
    """Raises UserError when the file cannot be decoded. The frame count in a container is a guess: it is checked."""
    if path.stat().st_size == 0:
        raise UserError(f"{path} cannot be read as a video: it is empty (0 bytes); copy it again")
    video = _open(path)
    try:
        said, rate = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), video.get(cv2.CAP_PROP_FPS)
        ok, first = video.read()
        if not ok:
            return _by_program(path)
        stamps = [video.get(cv2.CAP_PROP_POS_MSEC)]
        while len(stamps) <= COUNT_UP_TO and video.grab():
            stamps.append(video.get(cv2.CAP_PROP_POS_MSEC))
    finally:
        video.release()
    whole = len(stamps) <= COUNT_UP_TO
    return VideoFacts(
        len(stamps) if whole else max(said, len(stamps)), _plausible(rate), first.shape[1::-1],
        np.array(stamps) / 1000 if whole else None, _range_note(path),
    )  # fmt: skip


def _plausible(rate: float | None) -> float | None:
    return rate if rate and np.isfinite(rate) and 0 < rate < 10000 else None


def _by_program(path: Path) -> VideoFacts:
    """Facts of a video that OpenCV cannot decode. UserError where no program ffmpeg can either."""
    codec = codec_name(path)
    if program() is None:
        what = f"OpenCV cannot decode its codec {codec}" if codec else "it is damaged or its codec is unknown to OpenCV"
        given, converted = (shlex.quote(f"file:{p}") for p in (path, path.with_name(f"{path.stem}_h264.mp4")))
        command = f"ffmpeg -i {given} -c:v libx264 -crf 16 -pix_fmt yuv420p {converted}"
        raise UserError(f"{path} cannot be read as a video: {what}; install the program ffmpeg, which is then used, or "
                        f"convert the file: {command}")  # fmt: skip
    facts = program_facts(path)
    note = f"{path} is decoded by the program ffmpeg: OpenCV lacks its codec {codec or facts.codec}"
    return VideoFacts(len(facts.stamps), _plausible(facts.rate), facts.size, facts.stamps, (note, *_range_note(path)))


def _range_note(path: Path) -> tuple[str, ...]:
    kind = high_dynamic_range(path)
    if kind is None:
        return ()
    return (f"{path} was filmed in high dynamic range ({kind}), which is read as if it were the usual one: colours "
            "come out pale; switch HDR off in the camera, or convert the file to SDR",)  # fmt: skip


def video_frames(path: Path, numbers: np.ndarray) -> Iterator[np.ndarray]:
    """(H, W, 3) uint8 BGR. Decoded in order from the start: seeking in compressed video is not exact. `numbers` must
    not decrease."""
    video = _open(path)
    try:
        wanted = iter(numbers)
        target = next(wanted)
        for k in range(int(numbers[-1]) + 1):
            if not video.grab():
                if k == 0 and program() is not None:
                    yield from program_frames(path, numbers)
                    return
                raise UserError(f"{path} ends at frame {k}, but frame {numbers[-1]} was asked for: it is damaged")
            if k == target:
                ok, image = video.retrieve()
                if not ok:
                    raise UserError(f"{path}: frame {k} cannot be decoded: the file is damaged")
                while target == k:
                    yield image
                    target = next(wanted, None)
    finally:
        video.release()
