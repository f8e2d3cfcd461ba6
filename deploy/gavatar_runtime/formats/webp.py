"""Lossless WebP images (RFC 9649, section 3) with nothing but NumPy.

Pixels stand as they are, 32 bits each, under prefix codes of 8 bits throughout: valid for every reader, as large as the
raw image, and on whole bytes, so that a zip around it makes it small.
"""

from __future__ import annotations

import struct

import numpy as np

SIGNATURE = 0x2F
LARGEST = 1 << 14  # pixels of a side
PLACE_OF_EIGHT = 11  # where length 8 stands in the order in which the lengths of lengths are stored
_REVERSED = np.packbits(np.unpackbits(np.arange(256, dtype=np.uint8)).reshape(-1, 8)[:, ::-1])


def lossless_webp(image: np.ndarray) -> bytes:
    """(H, W, 4) uint8 RGBA, sides from 1 to LARGEST -> the contents of a .webp file. Every byte is kept, also where
    alpha is zero. Raises ValueError for another size."""
    height, width, _ = image.shape
    if not (1 <= height <= LARGEST and 1 <= width <= LARGEST):
        raise ValueError(f"a WebP image of {width} x {height} pixels")
    fields = [(SIGNATURE, 8), (width - 1, 14), (height - 1, 14), (1, 1), (0, 3)]  # alpha is used; version 0
    fields += [(0, 1), (0, 1), (0, 1)]  # no transform, no cache of colours, one set of codes for the whole image
    # The green alphabet goes on after its 256 values (copies, which do not occur): so many lengths are given, no more.
    # Two lengths of lengths beyond need bring the header to whole bytes.
    fields += [*_eight_bits_each(spare=2), (1, 1), (3, 3), (256 - 2, 8)]
    for _ in ("red", "blue", "alpha"):
        fields += [*_eight_bits_each(), (0, 1)]
    fields += [(1, 1), (0, 3)]  # distances of copies: one symbol, 0, which takes no bits
    header = sum(value << place for (value, _), place in zip(fields, _places(fields), strict=True))
    pixels = _REVERSED[image[..., [1, 0, 2, 3]]]  # a code of 8 bits is the value itself, its highest bit first
    stream = header.to_bytes(sum(bits for _, bits in fields) // 8, "little") + pixels.tobytes()
    chunk = b"VP8L" + struct.pack("<I", len(stream)) + stream + b"\0" * (len(stream) % 2)
    return b"RIFF" + struct.pack("<I", 4 + len(chunk)) + b"WEBP" + chunk


def _eight_bits_each(spare: int = 0) -> list[tuple[int, int]]:
    """The start of a prefix code whose lengths are all 8: that length alone has a code, of no bits."""
    count = PLACE_OF_EIGHT + 1 + spare
    return [(0, 1), (count - 4, 4), *((int(place == PLACE_OF_EIGHT), 3) for place in range(count))]


def _places(fields: list[tuple[int, int]]) -> list[int]:
    """Of each (value, bits) the bit that it begins at."""
    ends = np.cumsum([bits for _, bits in fields])
    return [0, *map(int, ends[:-1])]
