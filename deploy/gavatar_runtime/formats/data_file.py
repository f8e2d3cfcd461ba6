"""Data in whatever container it came: NumPy, pickle, joblib, PyTorch or JSON, told by how the file begins."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path
from typing import Any

from ..errors import UserError, cannot_read
from .foreign import foreign_start
from .joblib_file import is_packed, load_joblib
from .numpy_file import load_npy, load_npz
from .torch_file import is_older_format, load_torch


def load_data(path: str | os.PathLike) -> Any:
    """Dictionaries, lists, text, numbers and arrays of a file; tensors are arrays. Nothing in it is executed, and
    members of unknown kinds are `Unread`.

    The suffix does not matter: people rename, and a `.pth` may come from joblib. Raises UserError naming the file.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(64)
    except OSError as error:
        raise cannot_read(path, error) from None
    if start.startswith(b"\x93NUMPY"):
        return load_npy(path, lenient=True)
    if start.startswith(b"PK"):
        return load_torch(path, lenient=True) if _is_of_torch(path) else load_npz(path, lenient=True)
    if is_older_format(start):
        return load_torch(path, lenient=True)
    if start[:1] == b"\x80" or is_packed(start):
        return load_joblib(path, lenient=True)
    if start.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"["):
        return _json(path)
    if start[:1] in (b"(", b"}", b"]"):  # pickles of the oldest protocol have no mark
        return load_joblib(path, lenient=True)
    foreign = foreign_start(start)
    if foreign:
        raise UserError(f"{path} {foreign}")
    kind = path.suffix.lower() or "data"
    raise UserError(f"{path} is empty, damaged or not an {kind} file: it holds no arrays, pickle, tensors or JSON")


def _is_of_torch(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as file:
            return any(name == "data.pkl" or name.endswith("/data.pkl") for name in file.namelist())
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return path.suffix.lower() in (".pt", ".pth")


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes().decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is not valid JSON: {error}") from None
