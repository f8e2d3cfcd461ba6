"""What the file formats for Gaussians have in common: a file holds one frame."""

from __future__ import annotations

import abc
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...render.widening import as_filmed
from ...values.gaussians import Gaussians
from .frame_files import NumberedFiles, OneFile
from .output import FrameFormat, GaussianOutput, suffix_of


@dataclasses.dataclass
class GaussianFileOptions:
    """filmed: as large as the pixels of the training images showed them (`render.widening.as_filmed`); without, as they
    were learned, which shows gaps to programs that draw finer pixels, and from which training could go on."""

    filmed: bool = True


class GaussianFiles(GaussianOutput):
    """A file of the first frame, or one of each, `walk/%06d.ply`: a format adds both as its `suffixes`, and `encode`.

    What rasterizers ignore is left out, with a note: Gaussians with a field that is not finite or a scale below zero.
    """

    def __init__(self, options: Any, *, path: Path, frames: FrameFormat):
        super().__init__(path)
        self._files = NumberedFiles(path) if suffix_of(path).startswith("%") else OneFile(path)
        self._left_out = 0
        filmed = isinstance(options, GaussianFileOptions) and options.filmed  # a plugin's may have others
        self._pixel = frames.pixel if filmed else None

    @abc.abstractmethod
    def encode(self, gaussians: Gaussians) -> bytes:
        """The whole file. Fields are float32 arrays of finite numbers or None, as `Gaussians` has them; no normals."""

    def choose(self, count: int) -> list[int]:
        if isinstance(self._files, OneFile) and count > 1:
            each = self.path.with_suffix("") / f"%06d{self.path.suffix}"
            self.notes.append(f"{self.path} holds the first of {count} frames; {each} would hold each in a file")
            count = 1
        return list(range(count))

    def add(self, gaussians: Gaussians) -> None:
        sound = finite(gaussians)
        self._left_out += len(gaussians) - len(sound)
        try:
            self._files.next().write_bytes(self.encode(as_filmed(sound, self._pixel)))
        except OSError as error:
            raise UserError(f"{self.path} could not be written: {error.strerror or error}") from error

    def close(self) -> None:
        self._files.close()
        if self._left_out:
            self.notes.append(f"{self.path}: {self._left_out} Gaussians are left out, whose numbers are not finite")

    def discard(self) -> None:
        self._files.discard()


def finite(gaussians: Gaussians) -> Gaussians:
    """As float32, those whose fields are all finite and whose scales are not negative; without normals."""
    fields = {field.name: getattr(gaussians, field.name) for field in dataclasses.fields(gaussians)}
    with np.errstate(over="ignore"):  # what is too large for float32 becomes infinite
        arrays = {n: np.asarray(a, np.float32) for n, a in fields.items() if a is not None and n != "normals"}
    good = np.ones(len(gaussians), bool)
    for name, array in arrays.items():
        sound = np.isfinite(array) & (array >= 0) if name == "scales" else np.isfinite(array)
        good &= sound.all(tuple(range(1, array.ndim)))
    return Gaussians(**{name: array[good] for name, array in arrays.items()})
