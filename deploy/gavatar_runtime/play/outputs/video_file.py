"""Frames as a video."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...components import NoOptions
from ...errors import UserError
from ...formats.files import put_in_place, temporary_beside
from ...render.pixels import to_bytes
from .output import OUTPUTS, FrameFormat, ImageOutput, OutputTraits
from .video_encoder import INSTALL, find_encoder, require_encoder

NEEDS = f"OpenCV ({INSTALL}) or a program ffmpeg"


def _missing() -> str:
    return "" if find_encoder() else f"takes {NEEDS}"


@OUTPUTS.register("video", summary="an .mp4 video", needs=NEEDS, missing=_missing, traits=OutputTraits(preference=2))
class VideoFile(ImageOutput):
    """Odd sides are padded by one row or column of background: the codec halves its colour planes."""

    suffixes = (".mp4",)

    def __init__(self, options: NoOptions, *, path: Path, frames: FrameFormat):
        super().__init__(path)
        encoder = require_encoder(path)
        self._count = 0
        width, height = frames.width + frames.width % 2, frames.height + frames.height % 2
        self._even = np.empty((height, width, 3), np.uint8)
        self._even[:] = to_bytes(np.asarray(frames.background))
        self._temporary = temporary_beside(path)
        try:
            self._encoder = encoder(self._temporary, width, height, frames.fps)
        except OSError as error:
            self._temporary.unlink(missing_ok=True)  # a codec may have removed it
            raise UserError(
                f"{path}: no .mp4 of {width}x{height} pixels at {frames.fps:g} frames per second can be written "
                f"({error}); choose another size, or a folder of frames"
            ) from error

    def add(self, image: np.ndarray) -> None:
        if image.shape != self._even.shape:
            self._even[: image.shape[0], : image.shape[1]] = image
            image = self._even
        try:
            self._encoder.write(image)
        except OSError as error:
            raise UserError(f"{self.path} could not be written: {error}") from error
        self._count += 1

    def close(self) -> None:
        try:
            self._encoder.finish(self._count)
        except OSError as error:
            self.discard()
            raise UserError(f"{self.path} could not be written whole: {error}") from error
        put_in_place(self._temporary, self.path)

    def discard(self) -> None:
        self._encoder.abort()
        self._temporary.unlink(missing_ok=True)
