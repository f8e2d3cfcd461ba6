"""Frames that go nowhere, where only the time that they take is of interest."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .output import ImageOutput


class Nowhere(ImageOutput):
    """Keeps nothing. It is opened by programs, and has no name in the registry."""

    def __init__(self) -> None:
        super().__init__(Path())

    def add(self, image: np.ndarray) -> None:
        pass

    def close(self) -> None:
        pass

    def discard(self) -> None:
        pass
