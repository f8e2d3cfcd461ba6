"""What a video's container says that OpenCV does not tell: its codec where that is unknown, its dynamic range."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

TRANSFERS = {16: "PQ", 18: "HLG"}  # ITU-T H.273, transfer characteristics
CODECS = {
    b"V_AV1": "AV1", b"av01": "AV1", b"V_VP9": "VP9", b"vp09": "VP9", b"V_VP8": "VP8", b"V_MPEGH/ISO/HEVC": "HEVC",
    b"hvc1": "HEVC", b"hev1": "HEVC", b"dvh1": "HEVC", b"V_MPEG4/ISO/AVC": "H.264", b"avc1": "H.264", b"vvc1": "VVC",
    b"apcn": "ProRes", b"apch": "ProRes", b"apcs": "ProRes", b"apco": "ProRes", b"ap4h": "ProRes",
}  # fmt: skip
MOST = 64 << 20  # bytes of an mp4's index that are looked through
HEAD = 1 << 20  # bytes of a Matroska file in which its tracks are described


def high_dynamic_range(path: Path) -> str | None:
    """'PQ', 'HLG' or 'Dolby Vision', None for the usual range or where the container does not say."""
    matroska, head = _description(path)
    return _transfer_of_matroska(head) if matroska else _transfer_of_index(head)


def codec_name(path: Path) -> str | None:
    """The codec that the container names, None where it names none of `CODECS`."""
    head = _description(path)[1]
    return next((name for mark, name in CODECS.items() if mark in head), None)


def _description(path: Path) -> tuple[bool, bytes]:
    """Whether a file is Matroska (.webm too), and the part of it that describes its tracks."""
    with path.open("rb") as file:
        start = file.read(12)
        if start[:4] == b"\x1a\x45\xdf\xa3":
            return True, start + file.read(HEAD)
        known = start[4:8] in (b"ftyp", b"moov", b"wide", b"mdat", b"free", b"skip")
        return False, _index(file, path.stat().st_size) if known else b""


def _index(file: BinaryIO, size: int) -> bytes:
    """The box `moov` of an mp4 or mov, which may lie before or after the pictures."""
    at = 0
    while at + 16 <= size:
        file.seek(at)
        header = file.read(16)
        length, kind = struct.unpack(">I4s", header[:8])
        if length == 1:
            length = struct.unpack(">Q", header[8:])[0]
        if kind == b"moov":
            file.seek(at)
            return file.read(min(length or size - at, MOST))
        if length < 8:
            break
        at += length
    return b""


def _transfer_of_index(moov: bytes) -> str | None:
    at = moov.find(b"colrnclx")
    while at >= 0:
        found = TRANSFERS.get(int.from_bytes(moov[at + 10 : at + 12], "big"))
        if found:
            return found
        at = moov.find(b"colrnclx", at + 1)
    return "Dolby Vision" if b"dvh1" in moov or b"dvhe" in moov else None


def _transfer_of_matroska(head: bytes) -> str | None:
    """The element TransferCharacteristics (0x55BA) inside Colour (0x55B0): a size of 1 to 8 bytes, then a number."""
    colour = head.find(b"\x55\xb0")
    at = head.find(b"\x55\xba", colour, colour + 256) + 2 if colour >= 0 else 1
    if at < 2 or at + 16 > len(head) or head[at] == 0:
        return None
    width = 9 - head[at].bit_length()  # of the size
    size = int.from_bytes(head[at : at + width], "big") & ((1 << 7 * width) - 1)
    return TRANSFERS.get(int.from_bytes(head[at + width : at + width + size], "big")) if size <= 8 else None
