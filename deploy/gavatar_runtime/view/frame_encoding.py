"""How a drawn frame travels to the page: as JPEG where the native kernel is there, else as it is."""

from __future__ import annotations

import numpy as np

from .. import native_library as nl
from ..formats.jpeg import jpeg

QUALITY = 90  # of 100: below, the print on a shirt shows blocks


def encoded(image: np.ndarray, quality: int = QUALITY) -> tuple[str, bytes | memoryview]:
    """(kind, bytes) of an image (H, W, 3) uint8: `jpeg`, or `rgb`, rows from the top."""
    if not nl.available()[0]:
        return exact(image)
    return "jpeg", jpeg(image, quality)


def exact(image: np.ndarray) -> tuple[str, memoryview]:
    """The image as it is."""
    return "rgb", np.ascontiguousarray(image).data.cast("B")
