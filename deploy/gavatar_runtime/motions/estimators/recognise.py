"""Whose file it is: from what a container holds to the persons in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...formats.pickled_values import Unread
from ..field_names import ROOT_KEYS
from ..field_reader import as_array
from ..plausible import check_joints
from ..refusals import poses_missing, positions_refused, refuse_codes, refuse_others
from ..rotation_kinds import are_positions
from .found import Found, Person
from .frames import collection, phalp, romp
from .layouts import MOTION_X_FPS, layout_of, people_by
from .single_frames import lacks_frames

_DEEPEST = 4  # wrappers around what is looked for
# Motion-X's numbers of a frame, (T, 322): its README
_MOTION_X = {
    "root_orient": 3, "pose_body": 63, "pose_hand": 90, "pose_jaw": 3, "expression": 50, "face_shape": 100, "trans": 3,
    "betas": 10,
}  # fmt: skip


def people_in(content: Any, path: Path, rotations: str = "auto") -> Found:
    """The persons of a file's content and the tool that wrote it. rotations: a kind of `rotation_kinds`.

    UserError naming the file and what it holds where that is no motion of a body.
    """
    found = _found(content, path, rotations, 0)
    if found is not None and found.people:
        return found
    if isinstance(content, dict):
        raise poses_missing(path, content)
    what = f"something that {content.why}" if isinstance(content, Unread) else f"a {type(content).__name__}"
    raise UserError(f"{path} holds {what}: no poses of a person are in it")


def _found(content: Any, path: Path, rotations: str, depth: int) -> Found | None:
    if isinstance(content, np.ndarray) and content.dtype == object:
        content = content.tolist()
    array = content if isinstance(content, np.ndarray) else None
    if isinstance(content, (list, tuple)) and content and not isinstance(content[0], dict):
        array = as_array(content)
    if array is not None and array.dtype.kind in "fiu":
        return _of_array(array, path, rotations)
    if isinstance(content, dict):
        content = {key if isinstance(key, (str, int)) else str(key): _opened(v) for key, v in content.items()}
        return _of_dictionary(content, path, rotations, depth)
    return _of_list(list(content), path) if isinstance(content, (list, tuple)) else None


def _opened(value: Any) -> Any:
    """What an array of one object holds, as NumPy wraps a dictionary."""
    return value.item() if isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 0 else value


def _of_list(content: list, path: Path) -> Found | None:
    dictionaries = [entry for entry in content if isinstance(entry, dict)]
    for entry in dictionaries[:1]:
        refuse_codes(path, entry)
    found = collection(list(enumerate(content)))
    for entry in dictionaries[:1] if found is None else []:
        refuse_others(path, entry)
    return found


def _of_dictionary(content: dict, path: Path, rotations: str, depth: int) -> Found | None:
    refuse_codes(path, content)
    found = phalp(content) or romp(content)
    if found:
        return found
    layout = layout_of(content)
    if layout is not None:
        return people_by(layout, content)
    refuse_others(path, {str(key): value for key, value in content.items()})
    found = collection(list(content.items()))
    if found or depth == _DEEPEST or set(ROOT_KEYS) & set(content):  # a pelvis without a body is no motion
        return found
    inner = [value for value in content.values() if isinstance(value, (dict, list, tuple, np.ndarray))]
    for value in inner if len(inner) == 1 else [v for v in inner if isinstance(v, dict)]:
        found = _found(value, path, rotations, depth + 1)
        if found:
            return found
    return None


def _of_array(array: np.ndarray, path: Path, rotations: str) -> Found:
    """Of an array without names: Motion-X, or poses alone."""
    array = array[None] if (array.ndim == 1 and array.size > 3) or lacks_frames(array) else array
    if array.ndim == 2 and array.shape[1] == 322:
        parts = np.split(array, np.cumsum(list(_MOTION_X.values()))[:-1], 1)
        return Found("Motion-X", [Person("", dict(zip(_MOTION_X, parts, strict=True)))], MOTION_X_FPS)
    if array.ndim == 2 and len(array) and rotations == "auto":
        check_joints(path, "its array", array.shape[1])
    if rotations == "auto" and array.ndim == 3 and array.shape[2] == 3 and are_positions(array):
        raise positions_refused(path, "its array", array.shape[1])
    if array.ndim < 2:
        raise UserError(f"{path} holds an array of shape {array.shape}: no poses of a person")
    fields = {"poses": array}
    layout = layout_of(fields)
    if layout is None:
        raise poses_missing(path, fields)
    return people_by(layout, fields)
