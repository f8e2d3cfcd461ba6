"""Archives and arrays from strangers: what they claim to hold is held against what there is before memory is taken."""

from __future__ import annotations

import io
import math
import zipfile

import numpy as np

MOST_BYTES = 2 << 30  # of a member: a million Gaussians with 64 bases each are a quarter of it
SURELY_FINE, MOST_RATIO = 64 << 20, 100  # bytes below which no ratio is asked for; of real members it is below 10


class TooLarge(ValueError):
    """A member or an array that claims more than can be."""


def read_zipped(file: zipfile.ZipFile, name: str) -> bytes:
    """A member of a zip; KeyError if it is not there, TooLarge if it would unpack to more than 2 GiB, or to more than
    64 MiB and a hundred times its size."""
    info = file.getinfo(name)
    if info.file_size > MOST_BYTES or info.file_size > max(SURELY_FINE, MOST_RATIO * info.compress_size):
        raise TooLarge(f"it would unpack from {info.compress_size} to {info.file_size} bytes")
    return file.read(info)


def arrays_of_npz(data: bytes) -> dict[str, np.ndarray]:
    """The arrays of an .npz in memory. Raises what `zipfile` and NumPy do, ValueError for pickled objects, and TooLarge
    for a member or an array that claims more than there is."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        names = [name for name in file.namelist() if name.endswith(".npy")]
        return {name.removesuffix(".npy"): array_of_npy(read_zipped(file, name), name) for name in names}


def array_of_npy(data: bytes, name: str) -> np.ndarray:
    """The array of an .npy in memory, as `arrays_of_npz` has it."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(stream)
    claimed, there = math.prod(shape) * dtype.itemsize, len(data) - stream.tell()
    if not dtype.hasobject and (claimed != there or min(shape, default=0) < 0):
        raise TooLarge(f"{name} claims {claimed} bytes and has {there}")
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)
