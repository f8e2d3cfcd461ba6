"""Writing .glb: the JSON of glTF 2.0 and one buffer, in one file."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from ..version import __version__

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
ALIGNED = 4  # bytes: where a view of the buffer and each row of a vertex attribute begins
VERTICES = 34962  # the target of a view that holds vertex attributes
COMPONENTS = {"f4": 5126, "u1": 5121, "i1": 5120, "u2": 5123, "i2": 5122, "u4": 5125}
KINDS = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


class GlbFile:
    """document: the JSON so far, to which the caller adds. Arrays go into the buffer by `accessor`."""

    def __init__(self) -> None:
        self.document: dict[str, Any] = {"asset": {"version": "2.0", "generator": f"gavatar {__version__}"}}
        self._chunks: list[bytes] = []
        self._length = 0

    def add(self, kind: str, value: dict[str, Any]) -> int:
        """Append to an array of the document, such as `nodes`, and return the index."""
        self.document.setdefault(kind, []).append(value)
        return len(self.document[kind]) - 1

    def accessor(
        self, array: np.ndarray, *, normalized: bool = False, vertices: bool = False, bounds: bool = False
    ) -> int:
        """The index of an accessor of its own view. array: (N, ...) with N from 1, of a type of COMPONENTS; matrices
        (N, 4, 4) are given row by row. normalized: whole numbers stand for [0, 1] or [-1, 1]. vertices: each row
        begins on four bytes, as vertex attributes must. bounds: also give the least and the largest, which the format
        wants of positions and of times."""
        kind = KINDS[array.shape[1:]]
        stored = np.ascontiguousarray(np.swapaxes(array, 1, 2) if kind == "MAT4" else array)
        stored = stored.astype(stored.dtype.newbyteorder("<"), copy=False)
        rows = stored.reshape(len(stored), -1)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._length}
        if vertices:
            view["target"] = VERTICES
            width = rows.shape[1] * rows.itemsize
            if spare := -width % ALIGNED:
                rows = np.pad(rows.view(np.uint8).reshape(len(rows), width), ((0, 0), (0, spare)))
                view["byteStride"] = width + spare
        view["byteLength"] = rows.nbytes
        self._append(rows.tobytes())
        accessor: dict[str, Any] = {
            "bufferView": self.add("bufferViews", view), "componentType": COMPONENTS[array.dtype.str[1:]],
            "count": len(array), "type": kind,
        }  # fmt: skip
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor["min"], accessor["max"] = (
                np.atleast_1d(f(array, 0)).astype(float).tolist() for f in (np.min, np.max)
            )
        return self.add("accessors", accessor)

    def _append(self, data: bytes) -> None:
        data += b"\0" * (-len(data) % ALIGNED)
        self._chunks.append(data)
        self._length += len(data)

    def to_bytes(self) -> bytes:
        """The whole file."""
        if self._length:
            self.document["buffers"] = [{"byteLength": self._length}]
        text = json.dumps(self.document, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % ALIGNED)
        chunks = struct.pack("<2I", len(text), JSON_CHUNK) + text
        if self._length:
            chunks += struct.pack("<2I", self._length, BINARY_CHUNK) + b"".join(self._chunks)
        return struct.pack("<3I", MAGIC, VERSION, 12 + len(chunks)) + chunks
