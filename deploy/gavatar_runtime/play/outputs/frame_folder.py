"""Frames as images, one file each."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...components import NoOptions
from ...errors import UserError
from ...formats.png import write_png
from .frame_files import NumberedFiles
from .output import OUTPUTS, FrameFormat, ImageOutput, OutputTraits, suffix_of

FRAME_NAME = "%06d.png"


@OUTPUTS.register("frames", summary="a folder of numbered .png frames", traits=OutputTraits(preference=1))
class FrameFolder(ImageOutput):
    """A folder, of files 000000.png, 000001.png, ..., or as its name has it: `walk/frame_%03d.png`."""

    suffixes = ("/", "%d.png")

    def __init__(self, options: NoOptions, *, path: Path, frames: FrameFormat):
        super().__init__(path)
        self._files = NumberedFiles(path if suffix_of(path) == "%d.png" else path / FRAME_NAME)

    def add(self, image: np.ndarray) -> None:
        number = self._files.count
        try:
            write_png(self._files.next(), image)
        except OSError as error:
            raise UserError(f"{self.path}: frame {number} could not be written: {error.strerror or error}") from error

    def close(self) -> None:
        self._files.close()

    def discard(self) -> None:
        self._files.discard()
