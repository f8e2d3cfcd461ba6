"""PNG files (ISO/IEC 15948) with nothing but zlib."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"
RGB8 = struct.pack(">5B", 8, 2, 0, 0, 0)  # bits a channel, colour type RGB, deflate, the usual filters, not interlaced
SUB = 1  # the filter that keeps each byte's difference to the pixel on its left


def png_bytes(image: np.ndarray) -> bytes:
    """(H, W, 3) uint8 RGB, at least one pixel -> the contents of a .png file.

    One filter for all rows, and runs only, as OpenCV packs it: a third of the time of zlib's level 6 for a tenth more
    bytes.
    """
    height, width, _ = image.shape
    flat = image.reshape(height, 3 * width)
    rows = np.empty((height, 1 + 3 * width), np.uint8)
    rows[:, 0] = SUB
    rows[:, 1:4] = flat[:, :3]
    np.subtract(flat[:, 3:], flat[:, :-3], out=rows[:, 4:])  # modulo 256, as the format wants it
    packer = zlib.compressobj(1, strategy=zlib.Z_RLE)
    data = packer.compress(rows.data) + packer.flush()
    header = struct.pack(">2I", width, height) + RGB8
    return SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def write_png(path: str | os.PathLike, image: np.ndarray) -> None:
    """Write (H, W, 3) uint8 RGB. Raises OSError."""
    with open(path, "wb") as file:
        file.write(png_bytes(image))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
