"""Tensors that `torch.save` wrote, as NumPy arrays: without torch, and without running what a file asks for."""

from __future__ import annotations

import io
import math
import os
import zipfile
from typing import Any

import numpy as np

from ..errors import UserError
from .safe_pickle import _Machine, _plain, _Refused

_STORAGES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8", "IntStorage": "<i4",
    "ShortStorage": "<i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "?",
}  # fmt: skip


def load_torch(path: str | os.PathLike) -> Any:
    """What a file of torch 1.6 or later holds: dictionaries, lists, numbers, strings, and tensors as arrays.

    Raises UserError naming the file when it is missing, damaged, of the older format, or asks for anything but tensors
    of numbers; nothing is executed.
    """
    try:
        with zipfile.ZipFile(path) as file:
            pickles = [name for name in file.namelist() if name.endswith("/data.pkl") or name == "data.pkl"]
            if len(pickles) != 1:
                raise UserError(f"{path} is a zip without a data.pkl: not a file of torch.save")
            root = pickles[0].removesuffix("data.pkl")
            if f"{root}byteorder" in file.namelist() and file.read(f"{root}byteorder") != b"little":
                raise UserError(f"{path} was written on a big-endian machine: save it again on another")
            return _plain(_TorchMachine(io.BytesIO(file.read(pickles[0])), file, root).load())
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from None
    except _Refused as error:
        raise UserError(
            f"{path} asks for '{error}', which is not a tensor: it was not loaded and nothing ran"
        ) from None
    except zipfile.BadZipFile:
        raise UserError(
            f"{path} is not a zip of tensors: it is damaged or of torch before 1.6; load it there with "
            "torch.load(weights_only=True) and save it anew"
        ) from None
    except UserError:
        raise
    except Exception as error:  # whatever a hostile or damaged stream makes the machine stumble over
        cause = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UserError(f"{path} is not a readable file of tensors ({cause})") from None


class _Storage:
    """A type of number that the pickle names; never instantiated by it."""

    def __init__(self, dtype: str):
        self.dtype = np.dtype(dtype)


def _tensor(storage: np.ndarray, offset: int, size: tuple, stride: tuple, *_: Any) -> np.ndarray:
    """torch._utils._rebuild_tensor_v2 on a flat array; ValueError for a view beyond its end."""
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


def _parameter(data: np.ndarray, *_: Any) -> np.ndarray:
    """torch._utils._rebuild_parameter."""
    if not isinstance(data, np.ndarray):
        raise ValueError("a parameter without data")
    return data


class _TorchMachine(_Machine):
    """The restricted machine with tensors and their storages added to its table."""

    def __init__(self, stream: io.BytesIO, file: zipfile.ZipFile, root: str):
        super().__init__(stream)
        self._file, self._root = file, root

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return dict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return _parameter
        if module == "torch" and name in _STORAGES:
            return _Storage(_STORAGES[name])
        return super().find_class(module, name)

    def persistent_load(self, pid: Any) -> np.ndarray:
        kind, storage, key, _, count = pid
        if kind != "storage" or not isinstance(storage, _Storage) or not str(key).isalnum():
            raise ValueError("an unknown kind of storage")
        content = self._file.read(f"{self._root}data/{key}")
        if len(content) != count * storage.dtype.itemsize:
            raise ValueError(f"storage {key} is cut short")
        return np.frombuffer(content, storage.dtype)
