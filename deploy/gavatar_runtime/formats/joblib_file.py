"""What `joblib.dump` wrote: a pickle with the arrays' bytes between its operations, compressed or not."""

from __future__ import annotations

import bz2
import io
import lzma
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..errors import UserError, cannot_read
from .pickled_values import Dtype, Held, Plain, PlainReader, Refused, array_of
from .safe_pickle import Machine, cause

# How a file of each kind begins, and what unpacks it
_UNPACKERS: dict[bytes, Callable[[], Any]] = {
    b"\x1f\x8b": lambda: zlib.decompressobj(31),
    b"\x78": zlib.decompressobj,
    b"BZh": bz2.BZ2Decompressor,
    b"\xfd7zXZ": lzma.LZMADecompressor,
    b"\x5d\x00": lambda: lzma.LZMADecompressor(lzma.FORMAT_ALONE),
}
_LZ4 = b"\x04\x22\x4d\x18"
MOST_UNPACKED = 4 << 30  # bytes: an hour of meshes; more is a bomb


def load_joblib(path: str | os.PathLike, *, lenient: bool = False) -> Any:
    """Dictionaries, lists, numbers and NumPy arrays of a joblib file or a plain pickle; nothing is executed.

    Compression by zlib, gzip, bz2, lzma and xz is undone. lenient: as in `load_pickle`.
    Raises UserError naming the file when it is missing, damaged, or asks for anything else.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise cannot_read(path, error) from None
    try:
        stream = io.BytesIO(_unpacked(data, path))
        return PlainReader(lenient)(_JoblibMachine(stream, lenient=lenient).load())
    except UserError:
        raise
    except Refused as error:
        raise UserError(f"{path} asks for '{error}', which is not data: it was not loaded and nothing ran") from None
    except Exception as error:  # whatever a hostile or damaged stream makes the machine stumble over
        raise UserError(
            f"{path} is not a readable joblib file: it is damaged or of another kind ({cause(error)})"
        ) from None


def is_packed(data: bytes) -> bool:
    """Whether a file that begins so is compressed as joblib does it."""
    return data.startswith((*_UNPACKERS, _LZ4))


def _unpacked(data: bytes, path: str | os.PathLike) -> bytes:
    if data.startswith(_LZ4):
        raise UserError(f"{path} is compressed with lz4: save it again with joblib.dump(..., compress=3)")
    start = next((start for start in _UNPACKERS if data.startswith(start)), None)
    if start is None:
        return data
    out = _UNPACKERS[start]().decompress(data, MOST_UNPACKED)
    if len(out) >= MOST_UNPACKED:
        raise UserError(f"{path} unpacks to more than {MOST_UNPACKED >> 30} GiB: it was not read")
    return out


class _Wrapper(Held):
    """joblib.numpy_pickle.NumpyArrayWrapper: shape, order and dtype of an array whose bytes follow in the stream; those
    of an array of objects are a pickle of its own."""

    content: Any

    def __new__(cls, *arguments: Any) -> _Wrapper:
        made = super().__new__(cls)
        made.arguments, made.state, made.content = arguments, None, b""
        return made

    def read(self, stream: io.BytesIO, lenient: bool) -> None:
        state = self.state
        if not isinstance(state, dict) or not isinstance(state.get("dtype"), Dtype):
            raise ValueError("an array without dtype")
        dtype, shape = state["dtype"].value(PlainReader()), state.get("shape")
        if not isinstance(shape, tuple) or not all(type(n) is int and n >= 0 for n in shape):
            raise ValueError("an array without shape")
        if dtype.hasobject:
            self.content = _JoblibMachine(stream, lenient=lenient).load()
            return
        if state.get("numpy_array_alignment_bytes") is not None:
            stream.read(stream.read(1)[0])
        self.content = stream.read(int(np.prod(shape, dtype=object)) * dtype.itemsize)

    def value(self, plain: Plain) -> np.ndarray:
        dtype = plain(self.state["dtype"])
        if dtype.hasobject:
            return plain(self.content)
        return array_of(self.content, dtype, self.state["shape"], "F" if self.state.get("order") == "F" else "C", plain)


class _JoblibMachine(Machine):
    """The restricted machine with joblib's wrapper added to its table."""

    dispatch: ClassVar[dict] = dict(Machine.dispatch)

    def __init__(self, stream: io.BytesIO, *, lenient: bool):
        super().__init__(stream, encoding="latin1", lenient=lenient)
        self._stream = stream

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("joblib.numpy_pickle", "NumpyArrayWrapper"):
            return _Wrapper
        return super().find_class(module, name)

    def load_build(self) -> None:
        """As in the restricted machine; the bytes of an array stand right behind the state of its wrapper."""
        super().load_build()
        if isinstance(self.stack[-1], _Wrapper):
            self.stack[-1].read(self._stream, self._lenient)

    dispatch[b"b"[0]] = load_build
