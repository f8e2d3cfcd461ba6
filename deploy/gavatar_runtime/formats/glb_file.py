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
COMPONENTS = {"f4": 5126, "u1": 5121, "u2": 5123}
KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


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

    def accessor(self, array: np.ndarray, *, vertices: bool = False, bounds: bool = False) -> int:
        """The index of an accessor of its own view. array: (N, ...) with N from 1, of a type of COMPONENTS; matrices
        (N, 4, 4) are given row by row. vertices: it is an attribute of vertices, whose rows the format wants to be of
        whole fours of bytes. bounds: also give the least and the largest, which it wants of positions and of times."""
        kind = KINDS[array.shape[1:]]
        stored = np.ascontiguousarray(np.swapaxes(array, 1, 2) if kind == "MAT4" else array)
        stored = stored.astype(stored.dtype.newbyteorder("<"), copy=False)
        if vertices and stored[0].nbytes % ALIGNED:
            raise ValueError(f"vertices of {stored[0].nbytes} bytes")
        view = {"buffer": 0, "byteOffset": self._length, "byteLength": stored.nbytes}
        accessor: dict[str, Any] = {
            "bufferView": self.add("bufferViews", view | ({"target": VERTICES} if vertices else {})),
            "componentType": COMPONENTS[array.dtype.str[1:]], "count": len(array), "type": kind,
        }  # fmt: skip
        if bounds:
            low, high = (np.atleast_1d(end(array, 0)).astype(float).tolist() for end in (np.min, np.max))
            accessor |= {"min": low, "max": high}
        self._append(stored.tobytes())
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
