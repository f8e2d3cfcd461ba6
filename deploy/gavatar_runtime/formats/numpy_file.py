"""Files of NumPy arrays, .npz and .npy, whose pickled members are data and nothing more (see `safe_pickle`)."""

from __future__ import annotations

import io
import math
import os
import tokenize
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError, cannot_read
from .pickled_values import Unread
from .safe_pickle import loads

_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    EOFError,
    MemoryError,
    RuntimeError,
    NotImplementedError,
    SyntaxError,
    tokenize.TokenError,
)


def load_npz(path: str | os.PathLike, keys: Iterable[str] | None = None, *, lenient: bool = False) -> dict[str, Any]:
    """The arrays of an .npz by name (of `keys` those that it has, or all). Members that hold pickled objects are read
    as `load_pickle` does. lenient: what cannot be read of a member is `Unread`. Raises UserError naming file and
    member."""
    arrays = {}
    try:
        with zipfile.ZipFile(path) as file:
            names = [n.removesuffix(".npy") for n in file.namelist() if n.endswith(".npy")]
            for name in names if keys is None else [k for k in keys if k in names]:
                arrays[name] = _member(file, name, f"{path}: '{name}'", lenient)
    except OSError as error:
        raise cannot_read(path, error) from None
    except _DAMAGED as error:
        raise UserError(f"{path} is damaged or not an .npz file ({error})") from None
    return arrays


def load_npy(path: str | os.PathLike, *, lenient: bool = False) -> Any:
    """What an .npy file holds: an array, or the object of an array of one, as `np.save` writes a dictionary; read as
    `load_pickle` does. Raises UserError naming the file."""
    try:
        return _npy(Path(path).read_bytes(), str(path), lenient)
    except OSError as error:
        raise cannot_read(path, error) from None
    except _DAMAGED as error:
        why = next(iter(str(error).splitlines()), "")
        raise UserError(f"{path} is damaged or not an .npy file ({why})") from None


def _member(file: zipfile.ZipFile, name: str, source: str, lenient: bool) -> Any:
    data = file.read(f"{name}.npy")
    try:
        return _npy(data, source, lenient)
    except (UserError, *_DAMAGED) as error:
        if not lenient:
            raise
        return Unread(f"cannot be read ({next(iter(str(error).splitlines()), '')})")


def _npy(data: bytes, source: str, lenient: bool) -> Any:
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    try:
        shape, _, dtype = header(stream)
    except Exception as error:  # a damaged header is parsed as Python, which has many ways to fail
        raise ValueError(f"its header is damaged: {error}") from None
    if not dtype.hasobject:
        stated, there = math.prod(shape) * dtype.itemsize, len(data) - stream.tell()
        if stated > there:  # before memory is taken for them
            raise ValueError(f"its header states {stated} bytes of values, but {there} follow")
        stream.seek(0)
        return np.lib.format.read_array(stream, allow_pickle=False)
    value = loads(data[stream.tell() :], source, lenient=lenient)
    if isinstance(value, np.ndarray) and value.dtype == object and shape == () and value.size == 1:
        return value.reshape(-1)[0]
    return value
