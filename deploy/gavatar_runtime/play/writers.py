"""Where played frames go: a video, a folder of images, a contact sheet. One class a kind of output.

A writer is constructed as `factory(path, width=, height=, fps=, background=)`, which checks that the place can be
written, and says by `choose` which of the frames it wants; each then comes through `add`, and `close` finishes the
output. An output appears under its name when it is whole, or not at all.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from ..components import Registry
from ..errors import UserError, did_you_mean
from ..formats.files import atomic, put_in_place, temporary_beside
from ..formats.png import write_png
from ..render.pixels import to_bytes
from .video import INSTALL, require_encoder

FRAME_NAME = "{:06d}.png"


class Writer(Protocol):
    """suffixes: of the paths it writes, lower case with their dots; `/` stands for a folder."""

    suffixes: tuple[str, ...]

    def choose(self, count: int) -> list[int]:
        """Which of `count` frames it wants, ascending."""

    def add(self, image: np.ndarray) -> None:
        """Take the next wanted frame: (H, W, 3) uint8 RGB, whose buffer the caller may use again."""

    def close(self) -> None:
        """Finish the output and put it in place. UserError if what was written does not read back."""

    def discard(self) -> None:
        """Leave nothing behind; harmless after `close`."""


WRITERS: Registry[Writer] = Registry("output")


def open_writer(path: str | Path, *, width: int, height: int, fps: float, background=(1.0, 1.0, 1.0)) -> Writer:
    """The writer for `path`, chosen by its suffix; a name without one, or an existing folder, is a folder of frames.

    Raises UserError for a suffix that nothing writes and for a place that cannot be written to.
    """
    suffix = "/" if str(path).endswith(("/", "\\")) or Path(path).is_dir() else Path(path).suffix.lower() or "/"
    for component in WRITERS:
        if suffix in component.factory.suffixes:
            return component.factory(Path(path), width=width, height=height, fps=fps, background=background)
    suffixes = [s for c in WRITERS for s in c.factory.suffixes if s != "/"]
    raise UserError(f"cannot write '{path}': {did_you_mean(suffix, suffixes)} (a name without suffix is a folder)")


@WRITERS.register("video", summary="an .mp4 video, by OpenCV or the program ffmpeg")
class VideoFile:
    """Odd sides are padded by one row or column of background: the codec halves its colour planes."""

    suffixes = (".mp4",)

    def __init__(self, path: Path, *, width: int, height: int, fps: float, background):
        encoder = require_encoder(path)
        self.path, self.count = path, 0
        self._even = np.empty((height + height % 2, width + width % 2, 3), np.uint8)
        self._even[:] = to_bytes(np.asarray(background))
        self._temporary = temporary_beside(path)
        size = self._even.shape[1::-1]
        try:
            self._encoder = encoder(self._temporary, *size, fps)
        except OSError as error:
            self._temporary.unlink(missing_ok=True)  # a codec may have removed it
            raise UserError(
                f"{path}: no .mp4 of {size[0]}x{size[1]} pixels at {fps:g} frames per second can be written ({error}); "
                "choose another size, or a folder of frames"
            ) from error

    def choose(self, count: int) -> list[int]:
        return list(range(count))

    def add(self, image: np.ndarray) -> None:
        if image.shape != self._even.shape:
            self._even[: image.shape[0], : image.shape[1]] = image
            image = self._even
        try:
            self._encoder.write(image)
        except OSError as error:
            raise UserError(f"{self.path} could not be written: {error}") from error
        self.count += 1

    def close(self) -> None:
        try:
            self._encoder.finish(self.count)
        except OSError as error:
            self.discard()
            raise UserError(f"{self.path} could not be written whole: {error}") from error
        put_in_place(self._temporary, self.path)

    def discard(self) -> None:
        self._encoder.abort()
        self._temporary.unlink(missing_ok=True)


@WRITERS.register("frames", summary="a folder of numbered .png frames")
class FrameFolder:
    """Frames 000000.png, 000001.png, ... in a folder of their own, which replaces one of earlier frames."""

    suffixes = ("/",)

    def __init__(self, path: Path, *, width: int, height: int, fps: float, background):
        self.path, self.count = path, 0
        if path.exists():
            _check_replaceable(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
            self._temporary.chmod(path.stat().st_mode & 0o777 if path.exists() else 0o755)
        except OSError as error:
            raise UserError(f"{path} cannot be written: {error.strerror or error}") from error

    def choose(self, count: int) -> list[int]:
        return list(range(count))

    def add(self, image: np.ndarray) -> None:
        target = self._temporary / FRAME_NAME.format(self.count)
        try:
            write_png(target, image)
        except OSError as error:
            raise UserError(
                f"{self.path}: frame {self.count} could not be written: {error.strerror or error}"
            ) from error
        self.count += 1

    def close(self) -> None:
        if self.path.exists():
            _check_replaceable(self.path)
            shutil.rmtree(self.path)
        self._temporary.replace(self.path)

    def discard(self) -> None:
        shutil.rmtree(self._temporary, ignore_errors=True)


def _check_replaceable(path: Path) -> None:
    if not path.is_dir():
        raise UserError(f"{path} is a file, not a folder for frames: give another name")
    for entry in path.iterdir():
        if not re.fullmatch(r"\d{6}\.png", entry.name):
            raise UserError(f"{path} holds '{entry.name}', which is no frame of an earlier run: give another folder")


def _jpeg_writer(path: Path) -> Callable[[Path, np.ndarray], None]:
    try:
        import cv2
    except ImportError:
        raise UserError(f"{path}: to write a .jpg takes OpenCV ({INSTALL}); a .png does not") from None

    def write(temporary: Path, image: np.ndarray) -> None:
        if not cv2.imwrite(str(temporary), image[..., ::-1]):
            raise OSError("is the disk full?")

    return write


@WRITERS.register("sheet", summary="a contact sheet: up to 12 frames on one image")
class ContactSheet:
    """Frames evenly spaced over the motion, in reading order; one frame alone is simply an image."""

    suffixes = (".png", ".jpg", ".jpeg")
    frames = 12
    columns = 4

    def __init__(self, path: Path, *, width: int, height: int, fps: float, background):
        self.path = path
        self._write = write_png if path.suffix.lower() == ".png" else _jpeg_writer(path)
        self.background = to_bytes(np.asarray(background))
        self.images: list[np.ndarray] = []
        temporary_beside(path).unlink()  # a place that cannot be written shows now, not after rendering

    def choose(self, count: int) -> list[int]:
        shown = min(count, self.frames)
        return [i * count // shown for i in range(shown)]

    def add(self, image: np.ndarray) -> None:
        self.images.append(image.copy())  # a rasterizer may draw the next frame into the same buffer

    def close(self) -> None:
        if not self.images:
            raise UserError(f"{self.path}: there is no frame to show")
        columns = min(self.columns, len(self.images))
        rows = -(-len(self.images) // columns)
        height, width = self.images[0].shape[:2]
        sheet = np.empty((rows * height, columns * width, 3), np.uint8)
        sheet[:] = self.background
        for i, image in enumerate(self.images):
            row, column = divmod(i, columns)
            sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = image
        with atomic(self.path) as temporary:
            try:
                self._write(temporary, sheet)
            except OSError as error:
                raise UserError(f"{self.path} could not be written: {error.strerror or error}") from error

    def discard(self) -> None:
        self.images = []
