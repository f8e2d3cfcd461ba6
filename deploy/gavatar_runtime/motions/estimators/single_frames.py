"""One frame without an axis of frames: `(72,)`, `(24, 3)`, `(24, 3, 3)`, as demos of one image store it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...values.skeletons import SKELETONS
from ..field_names import BETAS_KEYS, BODY_KEYS, ROOT_KEYS, TRANS_KEYS, WHOLE_KEYS
from ..field_reader import as_array
from ..rotation_kinds import are_rotations

_WHOLE = tuple(len(names) for names in SKELETONS.values())
_BODY = (21, 23)


def lacks_frames(array: np.ndarray, joints: tuple[int, ...] = _WHOLE) -> bool:
    """Whether an array of poses is one frame: a row of numbers, (J, 3), (J, 4) or (J, 6) of as many joints as bodies
    have, or matrices (J, 3, 3)."""
    if array.ndim == 1:
        return array.size > 3
    if array.ndim == 2:
        return array.shape[0] in joints and array.shape[1] in (3, 4, 6)
    return array.ndim == 3 and array.shape[1:] in ((3, 3), (3, 2)) and array.shape[0] in joints


def with_frames(fields: dict[str, Any]) -> dict[str, Any]:
    """The fields with an axis of frames, where poses have none; as they are where they have one."""
    key = next((key for key in (*WHOLE_KEYS, *BODY_KEYS) if key in fields), None)
    array = None if key is None else as_array(fields[key])
    if key is None or array is None or array.dtype.kind not in "fiu":
        return fields
    if not lacks_frames(array, _BODY if key in BODY_KEYS else _WHOLE):
        return fields
    out = dict(fields)
    out[key] = array[None]
    for other in (*ROOT_KEYS, *TRANS_KEYS, *BETAS_KEYS):
        part = as_array(fields[other]) if other in fields else None
        one_matrix = part is not None and part.shape == (3, 3) and are_rotations(part.reshape(1, 9))
        if part is not None and (part.ndim == 1 or (other in ROOT_KEYS and one_matrix)):
            out[other] = part[None]
    return out
