"""Reading one picture, whatever its name, kind of pixels and orientation."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError


def read_frame(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 BGR, turned as EXIF says; grey and 16 bit become the same. UserError when it cannot be read."""
    return _decoded(path, _content(path), cv2.IMREAD_COLOR)


def read_as_stored(path: Path) -> np.ndarray:
    """(H, W) or (H, W, 3 or 4) as stored, 8 or 16 bit; JPEG, which has no alpha, turned as EXIF says."""
    content = _content(path)
    jpeg = content[:2] == b"\xff\xd8"
    image = _decoded(path, content, cv2.IMREAD_COLOR if jpeg else cv2.IMREAD_UNCHANGED)
    if image.dtype == bool:
        image = image.astype(np.uint8)
    if image.dtype not in (np.uint8, np.uint16):
        raise UserError(f"{path} has pixels of type {image.dtype}: store 8 or 16 bit")
    return image[..., 0] if image.ndim == 3 and image.shape[2] == 1 else image


def palette_indices(path: Path) -> tuple[np.ndarray, np.ndarray, bool] | None:
    """Of a PNG with a palette: indices (H, W) uint8, colours (N, 3) uint8 RGB and whether some are transparent; None
    for any other file."""
    content = _content(path)
    if content[:8] != b"\x89PNG\r\n\x1a\n" or len(content) < 33 or content[25] != 3:
        return None
    depth, colours, transparent, kept, at = content[24], b"", False, [content[:8]], 8
    while at + 12 <= len(content):
        size, kind = struct.unpack(">I4s", content[at : at + 8])
        body = content[at + 8 : at + 8 + size]
        if kind == b"PLTE":
            colours = body[: len(body) // 3 * 3]
        elif kind == b"tRNS":
            transparent = any(value < 255 for value in body)
        elif kind in (b"IHDR", b"IDAT", b"IEND"):
            if kind == b"IHDR":
                body = body[:9] + b"\x00" + body[10:]  # the same numbers, declared to be grey levels
            kept.append(struct.pack(">I4s", len(body), kind) + body + struct.pack(">I", zlib.crc32(kind + body)))
        at += 12 + size
    grey = _decoded(path, b"".join(kept), cv2.IMREAD_GRAYSCALE)
    return grey // (255 // (2**depth - 1)), np.frombuffer(colours, np.uint8).reshape(-1, 3), transparent


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from None


def _decoded(path: Path, content: bytes, flag: int) -> np.ndarray:
    """By cv2 from memory: it takes names in few encodings and none with some signs."""
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flag) if content else None
    except cv2.error:
        image = None
    if image is None:
        what = "it is damaged or of an unknown format" if content else "it is empty (0 bytes)"
        raise UserError(f"{path} cannot be read as an image: {what}")
    return image
