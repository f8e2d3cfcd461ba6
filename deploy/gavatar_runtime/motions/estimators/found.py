"""What a file of a pose estimator holds: its tool, and the fields of each person, under the names of `field_names`."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Hashable
from typing import Any

import numpy as np

from ..field_names import POSE_KEYS
from ..field_reader import as_array

STAYS = "the file says nothing of where the person is in the world: it stays in place"
CAMERA = "the person's way is relative to the camera, which may have moved"


@dataclasses.dataclass
class Person:
    """label: as the file names the person. fields: arrays by name. frames: (T,) numbers of the video's frames that the
    rows belong to, or None."""

    label: str
    fields: dict[str, Any]
    frames: np.ndarray | None = None

    def __len__(self) -> int:
        """Frames, as far as the first of the pose fields tells."""
        return next((rows_of(self.fields[key]) for key in POSE_KEYS if key in self.fields), 0)


@dataclasses.dataclass
class Found:
    """tool: that wrote the file, `` where only the names of fields are known. fps: that the tool always has, 0 for
    none. notes: on how it is read."""

    tool: str
    people: list[Person]
    fps: float = 0.0
    notes: tuple[str, ...] = ()


def rows_of(value: Any) -> int:
    """Frames of an array of poses: its rows, 1 without a second axis, 0 for what is no array."""
    array = as_array(value)
    return 0 if array is None else len(array) if array.ndim > 1 else 1


def by_person(frames: list[list[tuple[Hashable, dict[str, Any]]]]) -> list[Person]:
    """Persons with a row a frame, of the (label, fields of one frame) that every frame of a video holds.

    A field counts where all frames of a person have it in one shape.
    """
    rows: dict[Hashable, dict[int, dict[str, Any]]] = {}
    for number, entries in enumerate(frames):
        for label, fields in entries:
            rows.setdefault(label, {}).setdefault(number, fields)
    return [
        Person(str(label), _stacked(list(mine.values())), np.array(list(mine))) for label, mine in sorted_items(rows)
    ]


def sorted_items(mapping: dict) -> list[tuple]:
    """Items by their keys: numbers first, then text with its numbers counted (`9.jpg` before `10.jpg`)."""
    return sorted(mapping.items(), key=lambda item: natural(item[0]))


def natural(key: Hashable) -> tuple:
    """A key to sort by, with the numbers in a text counted."""
    parts = re.split(r"(\d+)", str(key))
    return tuple((0, int(part[:18]), "") if part.isdecimal() else (1, 0, part) for part in parts if part)


def _stacked(rows: list[dict[str, Any]]) -> dict[str, Any]:
    out = {}
    for key in rows[0]:
        values = [array for row in rows if (array := _one_row(row.get(key))) is not None]
        if len(values) == len(rows) and all(value.shape == values[0].shape for value in values):
            out[key] = np.stack(values)
    return out


def _one_row(value: Any) -> np.ndarray | None:
    """The numbers of one frame without a leading axis of one; rotation matrices keep their joint's."""
    array = as_array(value)
    if array is None or array.dtype.kind not in "fiu":
        return None
    while array.ndim > 1 and len(array) == 1 and array.shape[1:] != (3, 3):
        array = array[0]
    return array


def split_people(fields: dict[str, Any]) -> list[dict[str, Any]]:
    """The fields of each person where arrays have a leading axis of persons, or are lists of arrays; else one."""
    count = next((_people_in(fields[key]) for key in POSE_KEYS if key in fields and _people_in(fields[key])), 0)
    if not count:
        return [fields]
    return [{key: _of_person(value, i, count) for key, value in fields.items()} for i in range(count)]


def _people_in(value: Any) -> int:
    """Persons in an array of poses: of (P, T, 3J), (P, T, J, 3) or (P, T, J, 3, 3), or a list of those of each."""
    array = as_array(value)
    if array is None:
        items = list(value) if isinstance(value, (list, tuple, np.ndarray)) else []
        arrays = [as_array(item) for item in items]
        return len(items) if items and all(a is not None and a.ndim > 1 for a in arrays) else 0
    small = array.shape[-2:] in ((3, 3), (3, 2))
    of_one = array.ndim == 3 and array.shape[1] == 1 < len(array)  # (T, 1, 3J): frames of one person, as smplx has them
    wide = (
        (array.ndim == 3 and array.shape[-1] >= 60 and not of_one) or (array.ndim == 4 and not small) or array.ndim == 5
    )
    return len(array) if wide else 0


def _of_person(value: Any, index: int, count: int) -> Any:
    array = as_array(value)
    if array is not None and array.ndim < 2:
        return value
    several = isinstance(value, (list, tuple, np.ndarray)) and len(value) == count
    return value[index] if several else value
