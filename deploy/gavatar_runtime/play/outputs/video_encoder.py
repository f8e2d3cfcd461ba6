"""What turns frames into an .mp4: OpenCV where it is installed, else a program `ffmpeg`. The player needs neither."""

from __future__ import annotations

import contextlib
import functools
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import IO, Any, Protocol, cast

import numpy as np

from ...errors import UserError

INSTALL = "pip install 'gavatar[video]'"
# What the program is asked for, the first that it has: H.264, or what every build of ffmpeg brings.
CODECS = {"libx264": ("-preset", "veryfast", "-crf", "18"), "mpeg4": ("-q:v", "3")}


class Encoder(Protocol):
    """Turns frames into a file."""

    def __init__(self, path: Path, width: int, height: int, fps: float):
        """Sides are even. Raises OSError where it does not take such frames."""

    def write(self, image: np.ndarray) -> None:
        """Append (H, W, 3) uint8 RGB. Raises OSError with the cause where the encoder gave up."""

    def finish(self, count: int) -> None:
        """End the file. Raises OSError with the cause where it does not hold all `count` frames."""

    def abort(self) -> None:
        """Let go of the file; harmless after `finish`."""


def find_encoder() -> type[Encoder] | None:
    """The encoder to use on this machine, None where no video can be written."""
    if _opencv() is not None:
        return OpenCV
    return Ffmpeg if ffmpeg_codec() else None


def require_encoder(path: Path) -> type[Encoder]:
    """As `find_encoder`; UserError that names both remedies instead of None."""
    encoder = find_encoder()
    if encoder is None:
        raise UserError(
            f"{path}: to write a video takes OpenCV ({INSTALL}) or a program ffmpeg on the PATH; a folder of frames "
            "(a name without suffix) and a contact sheet (.png) take neither"
        )
    return encoder


def _opencv() -> Any:
    """The module cv2, None where it cannot be had."""
    try:
        import cv2
    except ImportError:  # also of a build that misses a library of the system, such as libGL
        return None
    return cv2


class OpenCV:
    """MPEG-4 Part 2, by the libraries that OpenCV's wheel carries."""

    def __init__(self, path: Path, width: int, height: int, fps: float):
        self._cv2: Any = _opencv()
        self.path = path
        self._video = self._cv2.VideoWriter(str(path), self._cv2.VideoWriter_fourcc(*"mp4v"), fps, (width, height))
        if not self._video.isOpened():
            raise OSError("OpenCV's codec refuses it")

    def write(self, image: np.ndarray) -> None:
        self._video.write(self._cv2.cvtColor(image, self._cv2.COLOR_RGB2BGR))

    def finish(self, count: int) -> None:
        self._video.release()
        # OpenCV reports neither a full disk nor a codec's refusal: read it back
        video = self._cv2.VideoCapture(str(self.path))
        whole = video.isOpened() and round(video.get(self._cv2.CAP_PROP_FRAME_COUNT)) == count and video.read()[0]
        video.release()
        if not whole:
            raise OSError("is the disk full?")

    def abort(self) -> None:
        self._video.release()


class Ffmpeg:
    """The program ffmpeg, fed through a pipe: H.264 if it was built with libx264, else MPEG-4 Part 2."""

    def __init__(self, path: Path, width: int, height: int, fps: float):
        codec = ffmpeg_codec()
        if codec is None:
            raise OSError(f"the program ffmpeg has neither of {' and '.join(CODECS)}")
        command = [
            str(shutil.which("ffmpeg")), "-hide_banner", "-loglevel", "error", "-y",
            "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:.6f}", "-i", "pipe:0",
            "-c:v", codec, *CODECS[codec], "-pix_fmt", "yuv420p", "-f", "mp4", str(path),
        ]  # fmt: skip
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `abort`
        self._program = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._said)
        self._frames = cast("IO[bytes]", self._program.stdin)

    def write(self, image: np.ndarray) -> None:
        try:
            self._frames.write(np.ascontiguousarray(image).data)
        except OSError as error:  # it ended
            raise OSError(f"ffmpeg says: {self._last_words() or error}") from error

    def finish(self, count: int) -> None:
        with contextlib.suppress(OSError):  # it ended, and says why below
            self._frames.close()
        if self._program.wait() != 0:
            raise OSError(f"ffmpeg says: {self._last_words() or f'exit code {self._program.returncode}'}")
        if not count:
            raise OSError("there is no frame to show")

    def abort(self) -> None:
        self._program.kill()
        with contextlib.suppress(OSError):  # what is still to be flushed goes nowhere
            self._frames.close()
        self._program.wait()
        self._said.close()

    def _last_words(self) -> str:
        self._program.wait()
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.strip()), "")


def ffmpeg_codec() -> str | None:
    """The first of CODECS that the program ffmpeg has, None without such a program."""
    program = shutil.which("ffmpeg")
    return _codec_of(program) if program else None


@functools.cache
def _codec_of(program: str) -> str | None:
    try:
        done = subprocess.run(
            [program, "-hide_banner", "-encoders"], capture_output=True, stdin=subprocess.DEVNULL, timeout=20
        )
    except (OSError, subprocess.SubprocessError):
        return None
    # lines such as ` V....D libx264              H.264 / AVC`
    names = {words[1] for words in map(str.split, done.stdout.decode(errors="replace").splitlines()) if len(words) > 1}
    return next((codec for codec in CODECS if codec in names), None)
