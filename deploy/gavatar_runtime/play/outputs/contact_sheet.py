"""Frames side by side on one image."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ... import native_library as nl
from ...errors import UserError, WrongValue
from ...formats.files import atomic, temporary_beside
from ...formats.jpeg import jpeg
from ...formats.png import write_png
from ...render.pixels import to_bytes
from .output import OUTPUTS, FrameFormat, ImageOutput

QUALITY = 95  # of 100


@dataclasses.dataclass
class SheetOptions:
    """shown: frames at most, evenly spaced over the motion. columns: images side by side."""

    shown: int = 12
    columns: int = 4


@OUTPUTS.register("sheet", config=SheetOptions, summary="a contact sheet: up to 12 frames on one image")
class ContactSheet(ImageOutput):
    """Frames in reading order; one frame alone is simply an image."""

    suffixes = (".png", ".jpg", ".jpeg")

    def __init__(self, options: SheetOptions, *, path: Path, frames: FrameFormat):
        super().__init__(path)
        for name, value in dataclasses.asdict(options).items():
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise WrongValue(f"`output.{name}={value}`: give a whole number from 1 up")
        self._options = options
        self._write = write_png if path.suffix.lower() == ".png" else _jpeg_writer(path)
        self._background = to_bytes(np.asarray(frames.background))
        self._images: list[np.ndarray] = []
        temporary_beside(path).unlink()  # a place that cannot be written shows now, not after rendering

    def choose(self, count: int) -> list[int]:
        shown = min(count, self._options.shown)
        return [i * count // shown for i in range(shown)]

    def add(self, image: np.ndarray) -> None:
        self._images.append(image.copy())

    def close(self) -> None:
        if not self._images:
            raise UserError(f"{self.path}: there is no frame to show")
        with atomic(self.path) as temporary:
            try:
                self._write(temporary, self._sheet())
            except OSError as error:
                raise UserError(f"{self.path} could not be written: {error.strerror or error}") from error

    def discard(self) -> None:
        self._images = []

    def _sheet(self) -> np.ndarray:
        columns = min(self._options.columns, len(self._images))
        rows = -(-len(self._images) // columns)
        height, width = self._images[0].shape[:2]
        sheet = np.empty((rows * height, columns * width, 3), np.uint8)
        sheet[:] = self._background
        for i, image in enumerate(self._images):
            row, column = divmod(i, columns)
            sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = image
        return sheet


def _jpeg_writer(path: Path) -> Callable[[Path, np.ndarray], None]:
    usable, reason = nl.available()
    if not usable:
        raise UserError(f"{path}: to write a .jpg takes the native kernel ({reason}); a .png does not")

    def write(temporary: Path, image: np.ndarray) -> None:
        temporary.write_bytes(jpeg(image, QUALITY))

    return write
