"""Masks of one camera's footage made better: by a network of the user's, or by the room behind the person."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.progress import shown

from .background import FRAMES, Background, learn_background, read_background
from .fused import Colours, Fuser
from .user_network import MattingNetwork

STILL = 0.002  # of the picture's longer side: a camera that moves more shows no single picture of the room


@dataclasses.dataclass(frozen=True)
class Made:
    """notes: what was done, sentences. background: (H, W, 3) uint8 BGR of the room where it is known."""

    notes: list[str]
    background: np.ndarray | None = None


class MaskMaker:
    """Decides by itself what can be done. background: picture of the room that the user gives. network: file of theirs
    that makes masks."""

    def __init__(self, background: Path | None, network: Path | None, progress: bool):
        self.file, self.progress = background, progress
        self.network = None if network is None else MattingNetwork(network)

    def __call__(
        self, name: str, images: Callable[[], Iterable[np.ndarray]], files: list[Path], moved: float | None
    ) -> Made:
        """Write better masks to `files`, where coarse ones lie. images: as for `Detector`. moved: how far the camera
        did, of the picture's longer side, None where nothing says. Raises UserError for a background or a network that
        does not fit the footage."""
        if self.network is not None:
            self._rewrite(name, images(), files, self.network)
            said = [f"{name}: masks by {self.network.name}"]
        else:
            said = []
        if moved is not None and moved > STILL:
            if self.file is not None:
                raise UserError(f"{self.file} is a background of a camera that stands still, but '{name}' moves: leave "
                                "`background` out")  # fmt: skip
            return Made(said)
        background, colours = self._background(images(), files)
        if background is None:
            return Made(said)
        if self.network is None:
            self._rewrite(name, images(), files, Fuser(background, colours))
            how = f"given by {self.file.name}" if self.file else "learnt from the footage"
            said = [
                f"{name}: masks are found before the background {how}, {100 * background.known.mean():.0f} % of it seen"
            ]
        return Made(said, background.picture)

    def _background(self, images: Iterable[np.ndarray], files: list[Path]) -> tuple[Background | None, Colours]:
        """The room, where it explains what is seen, and the person's colours."""
        chosen = set(evenly_spaced(len(files), FRAMES).tolist())
        sample = [image for t, image in enumerate(images) if t in chosen]
        masks = [_read(files[t]) for t in sorted(chosen)]
        colours = Colours()
        for image, mask in zip(sample, masks, strict=True):
            colours.add(image, mask)
        if self.file is not None:
            return read_background(self.file, sample[0].shape[1::-1], sample, masks), colours
        found = learn_background(sample, masks)
        return (found if found is not None and found.explains else None), colours

    def _rewrite(self, name: str, images: Iterable[np.ndarray], files: list[Path],
                 made: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:  # fmt: skip
        seen = shown(images, f"masks of '{name}'", "frame", total=len(files), show=self.progress)
        for image, file in zip(seen, files, strict=True):
            coarse = _read(file)
            if coarse.any() and not cv2.imwrite(str(file), made(image, coarse)):
                raise UserError(f"{file} could not be written: is the disk full?")


def _read(file: Path) -> np.ndarray:
    return np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
