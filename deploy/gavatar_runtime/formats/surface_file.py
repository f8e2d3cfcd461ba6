"""A sampled surface on disk."""

from __future__ import annotations

import os
import zipfile
import zlib
from typing import Any

import numpy as np

from ..errors import MissingFile, UserError
from ..values.surface import Surface
from .files import atomic


def save_surface(path: str | os.PathLike, surface: Surface) -> None:
    """Write `surface` to an .npz without pickle, whole or not at all. Raises UserError when the place is unwritable."""
    with atomic(path) as temporary, open(temporary, "wb") as file:
        arrays: dict[str, Any] = surface.to_arrays()
        np.savez(file, **arrays)


def load_surface(path: str | os.PathLike) -> Surface:
    """The surface in an .npz written by `save_surface`. Raises UserError for a damaged file or another, MissingFile for
    an absent one."""
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = dict(file)
    except FileNotFoundError:
        raise MissingFile(f"{path}: no such file; export the surface first") from None
    # what NumPy raises for a damaged archive depends on where the damage lies; AttributeError and TypeError mean .npy
    except (
        OSError,
        ValueError,
        EOFError,
        KeyError,
        AttributeError,
        TypeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise UserError(f"{path}: not a readable surface .npz ({error}); export it again") from error
    return Surface.from_arrays(arrays, str(path))
