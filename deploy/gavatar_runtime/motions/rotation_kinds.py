"""Rotations as files write them: axis-angle, degrees, matrices, quaternions, 6D; and positions, which are none."""

from __future__ import annotations

import numpy as np

from ..errors import UserError
from ..geometry.rotations import axis_angle_from_matrix, axis_angle_from_quaternion

KINDS = (
    "auto", "axis-angle", "degrees", "matrix", "quaternion-wxyz", "quaternion-xyzw", "6d", "6d-rows",
)  # fmt: skip
NUMBERS = {
    "axis-angle": 3,
    "degrees": 3,
    "matrix": 9,
    "quaternion-wxyz": 4,
    "quaternion-xyzw": 4,
    "6d": 6,
    "6d-rows": 6,
}
_ORTHONORMAL = 1e-2  # how far R R^T of a matrix written in float16 lies from the identity, with room
_SIX = "joints in 6D, two columns or two rows of their matrices: `rotations=6d` or 6d-rows says which"


def axis_angle(key: str, array: np.ndarray, kind: str = "auto") -> tuple[np.ndarray, str]:
    """(T, 3J) axis-angle in radians of rotations in any layout, and which kind they were.

    array: (T, J, 3, 3), (T, J, 3, 2), (T, J, K) or (T, J K), K numbers a rotation. kind: of `KINDS`; `auto` tells
    matrices and quaternions by their shape and values, whatever else is axis-angle; 6d are the first two columns of a
    matrix one after the other (Zhou et al. 2019), or beside each other in (..., 3, 2), 6d-rows the first two rows.
    Raises UserError naming `key` for what is not of that kind.
    """
    array = np.asarray(array)
    kind = told_kind(key, array) if kind == "auto" else kind
    rows = len(array)
    if kind == "matrix" and not are_rotations(array.reshape(rows, -1)):
        raise UserError(f"{key} holds matrices that are no rotations")
    numbers = array.reshape(rows, int(np.prod(array.shape[1:])))
    if numbers.shape[1] % NUMBERS[kind] or not numbers.shape[1]:
        count = NUMBERS[kind]
        raise UserError(f"{key} has shape {array.shape}, expected (T, {count}J), {count} numbers a joint of {kind}")
    if kind == "axis-angle":
        return numbers, kind
    beside = array.ndim > 2 and array.shape[-2:] == (3, 2)
    numbers = numbers.astype(np.float64)
    if kind == "degrees":
        return np.radians(numbers), kind
    if kind.startswith("quaternion"):
        q = numbers.reshape(rows, -1, 4)
        return axis_angle_from_quaternion(q if kind.endswith("wxyz") else np.roll(q, 1, -1)).reshape(rows, -1), kind
    matrices = numbers.reshape(rows, -1, 3, 3) if kind == "matrix" else _from_six(numbers.reshape(rows, -1, 6), beside)
    matrices = np.swapaxes(matrices, -1, -2) if kind == "6d-rows" else matrices
    return axis_angle_from_matrix(matrices).reshape(rows, -1), kind


def told_kind(key: str, array: np.ndarray) -> str:
    """The kind of rotations that shape and values tell, `axis-angle` where they tell nothing.

    UserError for 6D, which may be columns or rows, unless the key says that it is 6D.
    """
    numbers = array.reshape(len(array), -1)
    if "6d" in key.lower():
        return "6d"
    if array.dtype.kind not in "fiu" or not np.isfinite(numbers).all():
        return "axis-angle"
    if are_rotations(numbers):
        return "matrix"
    if array.ndim > 3 and array.shape[-2:] == (3, 3):
        raise UserError(f"{key} holds matrices that are no rotations")
    if numbers.shape[1] % 4 == 0 and _unit(numbers.reshape(len(array), -1, 4)):
        named = next((order for order in ("wxyz", "xyzw") if order in key.lower()), "")
        q = np.abs(numbers.reshape(-1, 4)).mean(0)  # most joints are turned by little
        return f"quaternion-{named}" if named else "quaternion-wxyz" if q[0] >= q[3] else "quaternion-xyzw"
    if array.shape[-2:] == (3, 2) or (array.ndim > 2 and array.shape[-1] == 6) or _is_six(numbers):
        raise UserError(f"{key} has shape {array.shape}: {_SIX}")
    return "axis-angle"


_WORDS = (
    ("6d-rows", ("6drows",)),
    ("6d", ("6d", "rot6d", "cont6d", "sixd", "ortho6d", "6dcolumns", "rotation6d")),
    ("quaternion-xyzw", ("xyzw", "quatxyzw", "quaternionxyzw", "scipy")),
    ("quaternion-wxyz", ("wxyz", "quatwxyz", "quaternionwxyz")),
    ("matrix", ("matrix", "matrices", "rotmat", "rotmats", "rotationmatrix", "mat3x3")),
    ("axis-angle", ("axisangle", "aa", "rotvec", "axisang", "angleaxis", "radians")),
    ("degrees", ("degrees", "deg", "axisangledegrees")),
)


def said_kind(value: object) -> str:
    """The kind that a word in a file names (`rot6d`, `xyzw`, `rotmat`), `auto` for any other word or thing."""
    array = np.asarray(value) if isinstance(value, (str, bytes, np.ndarray, np.generic)) else np.zeros(0)
    if array.size != 1 or array.dtype.kind not in "US":
        return "auto"
    text = array.reshape(-1)[0]
    text = text.decode("ascii", "replace") if isinstance(text, bytes) else str(text)
    word = "".join(c for c in text.lower() if c.isalnum())
    return next((kind for kind, words in _WORDS if word in words), "auto")


def unsure_order(array: np.ndarray) -> bool:
    """Whether the first and the last number of quaternions are much alike, so that neither is plainly the real part."""
    q = np.abs(array.reshape(-1, 4).astype(np.float64)).mean(0)
    return bool(abs(q[0] - q[3]) < 0.2)


def are_rotations(numbers: np.ndarray) -> bool:
    """Whether rows (T, 9J) are matrices with right angles, length one and no reflection."""
    if not numbers.size or numbers.shape[1] % 9:
        return False
    matrices = numbers.reshape(-1, 3, 3).astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        product = matrices @ np.swapaxes(matrices, -1, -2)
        return bool(np.abs(product - np.eye(3)).max() < _ORTHONORMAL and (np.linalg.det(matrices) > 0).all())


def _unit(vectors: np.ndarray) -> bool:
    with np.errstate(over="ignore"):
        return bool(vectors.size) and bool(np.abs(np.linalg.norm(vectors, axis=-1) - 1).max() < _ORTHONORMAL)


def _is_six(numbers: np.ndarray) -> bool:
    """Whether rows are pairs of directions at right angles, one after the other or one beside the other."""
    if not numbers.size or numbers.shape[1] % 6:
        return False
    six = numbers.reshape(-1, 6).astype(np.float64)
    for a, b in ((six[:, :3], six[:, 3:]), (six[:, ::2], six[:, 1::2])):
        if _unit(a) and _unit(b) and np.abs((a * b).sum(-1)).max() < _ORTHONORMAL:
            return True
    return False


def _from_six(six: np.ndarray, beside: bool) -> np.ndarray:
    """(T, J, 3, 3) whose first two columns are those of `six` (T, J, 6), brought to right angles."""
    a, b = (six[..., ::2], six[..., 1::2]) if beside else (six[..., :3], six[..., 3:])
    a = a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), 1e-12)
    b = b - a * (a * b).sum(-1, keepdims=True)
    b = b / np.maximum(np.linalg.norm(b, axis=-1, keepdims=True), 1e-12)
    return np.stack([a, b, np.cross(a, b)], -1)


# Of the first 22 joints of the SMPL family
_PARENTS = (0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
# Mean square of joint minus parent over that of joint minus mean: 0.13 to 0.4 for places of moving people, for their
# rotations, of which neighbours know little of each other, 1.3 to 3.4 (five clips, four captures, built-in motions)
_NEIGHBOURLY = 0.7
_MOST_JOINTS = 200
_STIFF = 0.02  # a bone keeps its length within that share
_MOVES = 0.02  # what moves less, in parts of the whole, tells nothing


def are_positions(poses: np.ndarray) -> bool:
    """Whether (T, J, 3) numbers are places of joints rather than rotations: neighbours in the body lie near each other,
    or joints in whatever order move but keep their distance."""
    if poses.ndim != 3 or not 10 <= poses.shape[1] <= _MOST_JOINTS or not np.isfinite(poses).all() or not len(poses):
        return False
    poses = poses[:: max(1, len(poses) // 50)].astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        return _is_neighbourly(poses[:, :22]) if poses.shape[1] >= 22 else _is_stiff(poses)


def _is_neighbourly(places: np.ndarray) -> bool:
    bones = ((places[:, 1:] - places[:, _PARENTS]) ** 2).sum(-1).mean(1)
    spread = ((places - places.mean(1, keepdims=True)) ** 2).sum(-1).mean(1)
    return bool(np.median(spread) > 1e-6 and np.median(bones) < _NEIGHBOURLY * np.median(spread))


def _is_stiff(places: np.ndarray) -> bool:
    """Half of the joints move and have a neighbour, not in the same place, to which they keep their distance."""
    if len(places) < 3:
        return False
    size = np.linalg.norm(np.ptp(places.reshape(-1, 3), axis=0))
    moving = np.linalg.norm(np.ptp(places, axis=0), axis=-1) > _MOVES * size
    if not size > 0 or moving.sum() < 5:
        return False
    distance = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    mean = distance.mean(0)
    stiff = (distance.std(0) < _STIFF * mean) & (mean > _MOVES * size)
    return bool(stiff[moving].any(1).mean() > 0.5)
