"""Tensors that `torch.save` wrote, as NumPy arrays: without torch, and without running what a file asks for.

Two formats: the zip of torch 1.6 and later, and the row of pickles before it, which tensors in a plain pickle still
use.
"""

from __future__ import annotations

import io
import math
import os
import types
import zipfile
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..errors import UserError, cannot_read
from .pickled_values import Held, Plain, PlainReader, Refused
from .safe_pickle import FURTHER, Machine, cause

_STORAGES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8", "IntStorage": "<i4",
    "ShortStorage": "<i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "?", "UntypedStorage": "u1",
    "BFloat16Storage": "<u2", "ComplexFloatStorage": "<c8", "ComplexDoubleStorage": "<c16",
}  # fmt: skip
_MAGIC = 0x1950A86A20F9469CFC6C  # the first number of the older format


def load_torch(path: str | os.PathLike, *, lenient: bool = False) -> Any:
    """What a file of torch.save holds: dictionaries, lists, numbers, strings, and tensors as arrays (bfloat16 as
    float32).

    lenient: as in `load_pickle`. Raises UserError naming the file when it is missing, damaged, or asks for anything but
    tensors of numbers; nothing is executed.
    """
    try:
        return loads_torch(Path(path).read_bytes(), str(path), lenient=lenient)
    except OSError as error:
        raise cannot_read(path, error) from None


def loads_torch(data: bytes, source: str = "tensors", *, lenient: bool = False) -> Any:
    """As `load_torch`, of bytes; `source` names them in messages."""
    try:
        made = _from_zip(data, source, lenient) if data[:2] == b"PK" else _from_pickles(data, lenient)
        return PlainReader(lenient)(made)
    except Refused as error:
        raise UserError(
            f"{source} asks for '{error}', which is not a tensor: it was not loaded and nothing ran"
        ) from None
    except UserError:
        raise
    except Exception as error:  # whatever a hostile or damaged stream makes the machine stumble over
        raise UserError(
            f"{source} is not a readable file of tensors: it is damaged or of another kind ({cause(error)})"
        ) from None


def is_older_format(data: bytes) -> bool:
    """Whether a file that begins so is one of torch before 1.6: a pickle of the magic number comes first."""
    return _MAGIC.to_bytes(10, "little") in data[:20]


def _from_zip(data: bytes, source: str, lenient: bool) -> Any:
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        pickles = [name for name in file.namelist() if name.endswith("/data.pkl") or name == "data.pkl"]
        if len(pickles) != 1:
            raise UserError(f"{source} is a zip without a data.pkl: not a file of torch.save")
        root = pickles[0].removesuffix("data.pkl")
        if f"{root}byteorder" in file.namelist() and file.read(f"{root}byteorder") != b"little":
            raise UserError(f"{source} was written on a big-endian machine: save it again on another")

        def content(kind: _StorageType, key: str, count: int) -> np.ndarray:
            if not key.isalnum():
                raise ValueError("an unknown kind of storage")
            return kind.numbers(file.read(f"{root}data/{key}"), count)

        return _TorchMachine(io.BytesIO(file.read(pickles[0])), content, lenient).load()


def _from_pickles(data: bytes, lenient: bool) -> Any:
    """The older format: magic number, version, machine, the content, the keys of its storages, and their bytes. The
    content names the storages before their bytes come, so that it is read twice."""
    stream, sizes = io.BytesIO(data), {}
    if Machine(stream).load() != _MAGIC:
        raise ValueError("it does not begin as torch.save does")
    for _ in range(2):
        Machine(stream).load()
    start = stream.tell()

    def seen(kind: _StorageType, key: str, count: int) -> np.ndarray:
        sizes[key] = kind
        return np.zeros(0)

    _TorchMachine(stream, seen, lenient).load()
    storages = {}
    for key in Machine(stream).load():
        count = int.from_bytes(stream.read(8), "little")
        content = stream.read(count * sizes[key].itemsize)
        storages[key] = sizes[key].numbers(content, count)
    stream.seek(start)
    return _TorchMachine(stream, lambda kind, key, count: storages[key], lenient).load()


class _StorageType(Held):
    """A type of number that the pickle names; never instantiated by it."""

    def __init__(self, name: str):
        super().__init__()
        self.dtype, self.half = np.dtype(_STORAGES[name]), name == "BFloat16Storage"

    @property
    def itemsize(self) -> int:
        return self.dtype.itemsize

    def numbers(self, content: bytes, count: int) -> np.ndarray:
        """(count,) numbers; a bfloat16 is the upper half of a float32."""
        if len(content) != count * self.itemsize:
            raise ValueError("a storage that is cut short")
        numbers = np.frombuffer(content, self.dtype)
        return (numbers.astype(np.uint32) << 16).view(np.float32) if self.half else numbers

    def value(self, plain: Plain) -> Any:
        raise ValueError("a type of number where data was expected")


class _Tensor(Held):
    """torch._utils._rebuild_tensor and its successors, on a flat array; ValueError for a view beyond its end."""

    def value(self, plain: Plain) -> np.ndarray:
        storage, offset, size, stride = (plain(argument) for argument in self.arguments[:4])
        if not isinstance(storage, np.ndarray) or len(size) != len(stride):
            raise ValueError("a tensor without storage")
        if not all(type(n) is int and n >= 0 for n in (offset, *size, *stride)):
            raise ValueError("a tensor with negative sizes")
        last = offset + sum((n - 1) * s for n, s in zip(size, stride, strict=True))
        if math.prod(size) and last >= len(storage):
            raise ValueError("a tensor larger than its storage")
        if math.prod(size) > len(storage) and math.prod(size) > 1 << 20:
            raise ValueError("an expanded tensor too large to copy")
        if not math.prod(size):
            return np.zeros(size, storage.dtype)
        strides = tuple(s * storage.itemsize for s in stride)
        return np.lib.stride_tricks.as_strided(storage[offset:], size, strides).copy()


class _Parameter(Held):
    """torch._utils._rebuild_parameter."""

    def value(self, plain: Plain) -> np.ndarray:
        data = plain(self.arguments[0])
        if not isinstance(data, np.ndarray):
            raise ValueError("a parameter without data")
        return data


class _StoredBytes(Held):
    """torch.storage._load_from_bytes: the storage of a tensor in a plain pickle is a file of torch.save of its own."""

    def value(self, plain: Plain) -> np.ndarray:
        content = self.arguments[0]
        if not isinstance(content, bytes):
            raise ValueError("a storage without bytes")
        return loads_torch(content, "a storage")


def _size(numbers: Any = ()) -> tuple:
    """torch.Size."""
    return tuple(numbers)


TENSORS = types.MappingProxyType(
    {
        **{("torch._utils", f"_rebuild_tensor{version}"): _Tensor for version in ("", "_v2")},
        **{("torch", name): _StorageType(name) for name in _STORAGES},
        ("torch.storage", "UntypedStorage"): _StorageType("UntypedStorage"),
        ("torch._utils", "_rebuild_parameter"): _Parameter,
        ("torch.storage", "_load_from_bytes"): _StoredBytes,
        ("torch", "Size"): _size,
    }
)
FURTHER.update(TENSORS)


class _TorchMachine(Machine):
    """The restricted machine with storages: `content(kind, key, count)` gives that of a key."""

    dispatch: ClassVar[dict] = dict(Machine.dispatch)

    def __init__(self, stream: io.BytesIO, content: Any, lenient: bool):
        super().__init__(stream, lenient=lenient)
        self._content = content

    def persistent_load(self, pid: Any) -> np.ndarray:
        kind, storage, key, _, count = pid[:5]
        if kind != "storage" or not isinstance(storage, _StorageType):
            raise ValueError("an unknown kind of storage")
        return self._content(storage, str(key), count)
