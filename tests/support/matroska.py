"""Matroska files as browsers record them: frames with time stamps and no word of a rate."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np


def element(name: int, *content: bytes) -> bytes:
    """One EBML element; its size in 8 bytes."""
    body = b"".join(content)
    return name.to_bytes((name.bit_length() + 7) // 8, "big") + struct.pack(">Q", len(body) | 1 << 56) + body


def number(name: int, value: int) -> bytes:
    return element(name, value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big"))


def write_matroska(
    path: Path,
    images: Sequence[np.ndarray],
    milliseconds: Sequence[int],
    codec: bytes = b"V_MJPEG",
    colour: bytes = b"",
) -> Path:
    """Images as JPEGs shown at those times. colour: children of the element Colour."""
    height, width = images[0].shape[:2]
    head = element(
        0x1A45DFA3, number(0x4286, 1), number(0x42F7, 1), number(0x42F2, 4), number(0x42F3, 8),
        element(0x4282, b"matroska"), number(0x4287, 4), number(0x4285, 2),
    )  # fmt: skip
    video = element(0xE0, number(0xB0, width), number(0xBA, height), *([element(0x55B0, colour)] if colour else []))
    track = element(0xAE, number(0xD7, 1), number(0x73C5, 1), number(0x83, 1), element(0x86, codec), video)
    info = element(0x1549A966, number(0x2AD7B1, 1_000_000), element(0x4D80, b"test"), element(0x5741, b"test"))
    clusters = []
    for image, time in zip(images, milliseconds, strict=True):
        jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        clusters.append(element(0x1F43B675, number(0xE7, time), element(0xA3, b"\x81\x00\x00\x80", jpeg)))
    path.write_bytes(head + element(0x18538067, info, element(0x1654AE6B, track), *clusters))
    return path
