"""Arrays of a file by name, checked as they are taken: what every reader of fields shares."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError, frames_named
from ..formats.pickled_values import Unread
from .field_names import SAID_KEYS
from .rotation_kinds import NUMBERS, axis_angle, said_kind, told_kind, unsure_order


class FieldReader:
    """The arrays of one person, by name. path: named in every message. rotations: a kind of `rotation_kinds`.
    notes: sentences for the user, added as fields are read."""

    def __init__(self, path: Path, arrays: Mapping[str, Any], rotations: str = "auto"):
        said = next((said_kind(arrays[key]) for key in SAID_KEYS if key in arrays), "auto")
        self.path, self.arrays, self.kind = path, arrays, said if rotations == "auto" else rotations
        self.notes: list[str] = []

    def key(self, keys: tuple[str, ...]) -> str | None:
        """The first of the names that the file has."""
        return next((key for key in keys if key in self.arrays), None)

    def numbers(self, key: str) -> np.ndarray:
        """An array as it stands; UserError where it is none of numbers."""
        value = self.arrays[key]
        if isinstance(value, Unread):
            raise UserError(f"{self.path}: {key} {value.why}")
        array = as_array(value)
        if array is None:
            raise UserError(f"{self.path}: {key} is not a plain array of numbers")
        if array.dtype.kind not in "fiu":
            raise UserError(f"{self.path}: {key} holds {array.dtype} values, expected numbers")
        return array

    def finite(self, key: str, array: np.ndarray) -> np.ndarray:
        """(T, ...) as float32; what overflows there counts as infinite too."""
        with np.errstate(over="ignore"):
            array = np.asarray(array, np.float32)
        bad = ~np.isfinite(array).all(tuple(range(1, array.ndim)))
        if bad.any():
            where = "" if key == "betas" else f" at {frames_named(np.flatnonzero(bad))}"
            raise UserError(f"{self.path}: {key} holds NaN or infinite values{where}")
        return array

    def part(self, key: str, width: int | None) -> np.ndarray:
        """(T, K) numbers a frame, K = width where that is given."""
        array = self.numbers(key)
        array = array.reshape(1, -1) if array.ndim < 2 else array.reshape(len(array), int(np.prod(array.shape[1:])))
        if width is not None and array.shape[1] != width:
            raise UserError(f"{self.path}: {key} holds {array.shape[1]} numbers a frame, expected {width}")
        return self.finite(key, array)

    def turned(self, key: str, width: int | None = None) -> tuple[np.ndarray, str]:
        """(T, 3J) axis-angle in radians of rotations of any kind, 3J = width where that is given, and the kind."""
        array = self.numbers(key)
        array = array[None] if array.ndim < 2 else array
        array, count = self.finite(key, array), int(np.prod(array.shape[1:]))
        if len(array) == 0:
            return np.zeros((0, width or count), np.float32), "axis-angle"
        name = f"{self.path}: {key}"
        kind = told_kind(name, array) if self.kind == "auto" else self.kind
        if width is not None and count * 3 != width * NUMBERS[kind]:
            raise UserError(f"{name} holds {count} numbers a frame, expected {width // 3 * NUMBERS[kind]}")
        if self.kind == "auto" and kind.startswith("quaternion") and unsure_order(array):
            self.notes.append(
                f"{key} holds quaternions, it is hard to say in which order: {kind[-4:]} is taken; "
                "`rotations=quaternion-wxyz` or quaternion-xyzw says it"
            )
        values, kind = axis_angle(name, array, kind)
        return np.asarray(values, np.float32), kind


def as_array(value: Any) -> np.ndarray | None:
    """An array of a list, a number or an array; None for what is none: dictionaries, rows of different lengths."""
    if not isinstance(value, (np.ndarray, np.generic, list, tuple, int, float, str)):
        return None
    try:
        array = np.asarray(value)
        if array.dtype == object:
            array = np.asarray([np.asarray(row) for row in array.reshape(-1)]) if array.size else array
    except ValueError:
        return None
    return None if array.dtype == object else array
