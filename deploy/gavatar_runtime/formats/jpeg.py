"""JPEG images by the native kernel."""

from __future__ import annotations

import numpy as np

from .. import native_library as nl
from ..errors import UserError

LARGEST = 65535  # pixels of a side


def jpeg(image: np.ndarray, quality: int = 90) -> bytes:
    """(H, W, 3) uint8 sRGB, sides from 1 to LARGEST -> the contents of a .jpg file: baseline, 4:4:4, with the
    standard's own tables (ITU T.81, annex K; quality from 1 to 100 as the Independent JPEG Group counts it).

    Raises ValueError for another shape or kind, and UserError without the native kernel or for another quality.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"a JPEG image of shape {image.shape} and kind {image.dtype}")
    height, width, _ = image.shape
    if not (1 <= height <= LARGEST and 1 <= width <= LARGEST):
        raise ValueError(f"a JPEG image of {width} x {height} pixels")
    if not 1 <= quality <= 100:
        raise UserError(f"`quality={quality}`: give a whole number from 1 to 100")
    pixels = np.ascontiguousarray(image)
    library = nl.library()
    out = np.empty(library.gv_jpeg_most(height, width), np.uint8)
    length = library.gv_jpeg(height, width, pixels.ctypes.data, quality, out.ctypes.data)
    if length < 0:
        nl.check(length)
    return out[:length].tobytes()
