"""Where pictures come from: a webcam or a clip, as fast as they are shown there."""

from __future__ import annotations

import math
import os
from pathlib import Path
from time import perf_counter, sleep
from types import ModuleType
from typing import Any

import numpy as np

from ..errors import MissingFile, UserError
from .drivers import why_not

USUAL_RATE = 30.0  # frames a second of a clip that does not say


class LivePictures:
    """A webcam, by its number, or a video file.

    what: `0` or `clip.mp4`. name: for a user. Raises UserError where there is no such camera or video.
    """

    def __init__(self, what: str):
        self._cv2 = _opencv()
        self.camera = int(what) if what.isascii() and what.isdigit() and len(what) < 4 else None
        self.name = f"camera {self.camera}" if self.camera is not None else Path(what).name
        self._video = self._opened(what)
        said = self._video.get(self._cv2.CAP_PROP_FPS)
        self.rate = said if math.isfinite(said) and 1 <= said <= 1000 else USUAL_RATE
        self.skipped = 0  # frames of a clip that came too late to be looked at
        self._start, self._count, self._before = perf_counter(), 0, 0.0
        self._first = self._read()
        if self._first is None:
            self.close()
            raise UserError(self._no_picture(what))

    def read(self) -> tuple[np.ndarray, float] | None:
        """The picture to look at now, (H, W, 3) uint8, blue first, and its time in seconds from the first; None after
        the last of a clip. Of a clip, waits until it is due, and leaves out those that are overdue."""
        if self._first is not None:
            first, self._first = self._first, None
            self._start = perf_counter()
            self._count = 1
            return first, 0.0
        if self.camera is not None:
            image = self._read()
            return None if image is None else (image, perf_counter() - self._start)
        while (self._count + 1) / self.rate < perf_counter() - self._start:
            if not self._video.grab():
                return None
            self._count += 1
            self.skipped += 1
        time = self._count / self.rate
        sleep(max(0.0, time - (perf_counter() - self._start)))
        image = self._read()
        self._count += 1
        return None if image is None else (image, time)

    def again(self) -> bool:
        """Go back to the first picture of a clip; False where that cannot be."""
        if self.camera is not None:
            return False
        self._video.set(self._cv2.CAP_PROP_POS_FRAMES, 0)
        self._first = self._read()
        return self._first is not None

    def close(self) -> None:
        """Let the camera or file go."""
        self._video.release()

    def _read(self) -> np.ndarray | None:
        done, image = self._video.read()
        return image if done and image is not None and image.size else None

    def _opened(self, what: str) -> Any:
        cv2 = self._cv2
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # its complaints are not for a user
        level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            if self.camera is not None:
                video = cv2.VideoCapture(self.camera)
                video.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture, not the oldest kept
            else:
                if not Path(what).is_file():
                    raise MissingFile(f"`drive={what}` is no camera's number and no file that exists")
                video = cv2.VideoCapture(str(Path(what).absolute()))
                video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        except UnicodeEncodeError:
            raise UserError(f"{what} has a name that is no text to OpenCV: rename it") from None
        finally:
            cv2.utils.logging.setLogLevel(level)
        if not video.isOpened():
            raise UserError(self._no_picture(what))
        return video

    def _no_picture(self, what: str) -> str:
        if self.camera is not None:
            return f"`drive={what}`: camera {what} gives no picture: connect one, and end what else uses it"
        return f"{what} cannot be read as a video: give an .mp4, .mov, .webm or .avi that a player shows"


def source_to_drive(what: str) -> LivePictures:
    """The camera or clip `what`. Raises UserError where there is nothing that could follow a person in it."""
    reason = why_not()
    if reason:
        raise UserError(reason)
    return LivePictures(what)


def _opencv() -> ModuleType:
    try:
        import cv2
    except ImportError:
        raise UserError("reading a camera or a clip needs OpenCV: pip install 'gavatar[video]'") from None
    return cv2
