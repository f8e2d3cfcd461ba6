"""The forms in which a pose is handed to an avatar: joints in rows, one flat list, or the parts that smplx names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import WrongValue, did_you_mean
from ..motions.fitting import HAND_DATA
from ..values.body import FACE_JOINTS
from ..values.skeletons import FINGERS, SKELETONS, SMPL, skeleton_of
from .played_body import PlayedBody

FACE_PARTS = dict(zip(("jaw_pose", "leye_pose", "reye_pose"), FACE_JOINTS, strict=True))
HAND_PARTS = ("left_hand_pose", "right_hand_pose")
HAND_WORDS = ("use_pca", "flat_hand_mean")
PARTS = ("global_orient", "body_pose", *FACE_PARTS, *HAND_PARTS, *HAND_WORDS)


def joint_rows(pose: Any, joint_names: Sequence[str]) -> np.ndarray:
    """(K, 3) float32 axis-angle of a pose in rows (K, 3) or flat (3 K,), with a leading axis of one or without.

    pose: whatever NumPy makes an array of. K is the number of `joint_names`, the body's own, or that of a skeleton of
    the SMPL family: 22, 24 (SMPL), 52 (SMPL-H, AMASS) or 55 (SMPL-X). Raises WrongValue for anything else, and for NaN
    or infinite numbers.
    """
    given = numbers("pose", pose)
    rows = given[0] if given.ndim > 1 and len(given) == 1 and given.shape[1:] != (3,) else given
    if rows.ndim == 1 and rows.size % 3 == 0:
        rows = rows.reshape(-1, 3)
    joints = len(joint_names)
    counts = sorted({joints, *map(len, SKELETONS.values())})
    if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) not in counts:
        raise WrongValue(
            f"pose has shape {given.shape}: give axis-angle of the body's {joints} joints as ({joints}, 3) or "
            f"({3 * joints},), or of a skeleton of the SMPL family, of {', '.join(map(str, counts))} joints"
        )
    bad = ~np.isfinite(rows).all(1)
    if bad.any():
        names = joint_names if len(rows) == joints else skeleton_of(len(rows))[1]
        raise WrongValue(f"the pose of joint '{names[int(np.argmax(bad))]}' is NaN or infinite")
    return rows


def pose_of_parts(parts: Mapping[str, Any], body: PlayedBody) -> tuple[np.ndarray, tuple[str, ...]]:
    """(J, 3) float32 axis-angle of a body from parts of a pose, and the names of what they move that the body lacks.

    parts, by the names of smplx, each flat, in rows of three or with a leading axis of one; joints of those left out
    are at rest. global_orient: 3 numbers. body_pose: 63, the 21 joints from the first hip on, or 69, SMPL's 23.
    jaw_pose, leye_pose, reye_pose: 3. left_hand_pose, right_hand_pose: 45 numbers are rotations of 15 joints about the
    flat hand; fewer are coefficients of the body's principal components about its mean hand. use_pca and
    flat_hand_mean, True or False, say otherwise.
    Raises WrongValue for an unknown part, one of another length, and NaN or infinite numbers.
    """
    for name in parts:
        if name == "betas":
            raise WrongValue("an avatar has the shape that it was trained with: leave `betas` out")
        if name not in PARTS:
            raise WrongValue(f"a pose has no part '{name}': {did_you_mean(name, PARTS)}")
    given = {name: _finite(name, value) for name, value in parts.items() if name not in HAND_WORDS}
    turned = _body_joints(given)
    for part, joint in FACE_PARTS.items():
        if part in given:
            turned[joint] = _of_length(part, given[part], 3)
    lacking = []
    for side, part in enumerate(HAND_PARTS):
        if part in given:
            hand = _hand(given[part], part, side, body, *(parts.get(word) for word in HAND_WORDS))
            turned |= {} if hand is None else dict(zip(FINGERS[15 * side :], hand, strict=False))
            lacking += [HAND_DATA] if hand is None and given[part].any() else []
    pose = np.zeros((len(body.joint_names), 3)) if body.rest_pose is None else body.rest_pose.copy()
    for joint, rotation in turned.items():
        if joint in body.joint_names:
            pose[body.joint_names.index(joint)] = rotation
        elif np.any(rotation):
            lacking.append(joint)
    return pose.astype(np.float32), tuple(dict.fromkeys(lacking))


def numbers(name: str, value: Any) -> np.ndarray:
    """The array given for `name` as float32, infinite where that overflows; WrongValue where it is none of numbers."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:  # the last is a tensor's that has a gradient
        raise WrongValue(f"{name} is no array of numbers: {error}") from None
    if array.dtype.kind not in "fiu":
        raise WrongValue(f"{name} is no array of numbers: it holds {array.dtype}")
    with np.errstate(over="ignore"):
        return array.astype(np.float32, copy=False)


def _finite(name: str, value: Any) -> np.ndarray:
    array = numbers(name, value).reshape(-1)
    if not np.isfinite(array).all():
        raise WrongValue(f"{name} holds NaN or infinite values")
    return array


def _of_length(name: str, values: np.ndarray, *lengths: int) -> np.ndarray:
    if len(values) not in lengths:
        raise WrongValue(f"{name} holds {len(values)} numbers, expected {' or '.join(map(str, lengths))}")
    return values


def _body_joints(given: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Rotations of the root and the body by their joints' names."""
    turned = {}
    if "global_orient" in given:
        turned[SMPL[0]] = _of_length("global_orient", given["global_orient"], 3)
    if "body_pose" in given:
        rows = _of_length("body_pose", given["body_pose"], 63, 69).reshape(-1, 3)
        turned |= dict(zip(SMPL[1:], rows, strict=False))
    return turned


def _hand(
    values: np.ndarray, part: str, side: int, body: PlayedBody, pca: bool | None, flat: bool | None
) -> np.ndarray | None:
    """(15, 3) axis-angle of one hand, None where the body lacks the data that this takes."""
    pca = len(values) != 45 if pca is None else bool(pca)
    relative = pca if flat is None else not flat
    if not pca:
        _of_length(part, values, 45)
    if not (pca or relative):
        return values.reshape(15, 3)
    if body.hands is None:
        return None
    try:
        return body.hands.pose(side, values, pca=pca, relative=relative)
    except ValueError as error:
        raise WrongValue(f"{part}: this body has {error}") from None
