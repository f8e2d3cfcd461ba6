"""How a drawn frame travels to the page: as JPEG where something here can write it, else as it is."""

from __future__ import annotations

from types import ModuleType

import numpy as np

QUALITY = 90  # of 100: below, the print on a shirt shows blocks


def encoded(image: np.ndarray, quality: int = QUALITY) -> tuple[str, bytes | memoryview]:
    """(kind, bytes) of an image (H, W, 3) uint8: `jpeg`, or `rgb`, rows from the top."""
    cv2 = _opencv()
    if cv2 is None:
        return exact(image)
    # halved colour would blur red on white
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    done, data = cv2.imencode(".jpg", image[:, :, ::-1], flags)
    if not done:
        return exact(image)
    return "jpeg", data.data.cast("B")


def exact(image: np.ndarray) -> tuple[str, memoryview]:
    """The image as it is."""
    return "rgb", np.ascontiguousarray(image).data.cast("B")


def _opencv() -> ModuleType | None:
    try:
        import cv2
    except ImportError:
        return None
    return cv2
