"""A motion of any rig on the skeleton of the SMPL family.

Rest poses differ: a T-pose, arms hanging, a splayed stance, another axis upwards. So orientations are carried over as
what they do to a bone: at every frame a limb of the body points where the rig's limb points, and everything else
(spine, head, collars, hands, feet) turns from an upright stance as far as the rig's does from its own.

Per joint, with R(t) the rig's world orientation relative to its rest, B the rotation from the body's upright frame
(left x, up y, front z) to the rig's at rest, W the one from the rig's world to the y-up world and a the shortest
rotation that takes B's image of the body's resting bone to the rig's::

    R_body(t) = W R(t) a B
"""

from __future__ import annotations

import numpy as np

from ..errors import UserError
from ..formats.bvh_file import Bvh
from ..geometry.rotations import (
    axis_angle_from_matrix,
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_between,
    slerp,
)
from ..values.motion import Motion
from ..values.skeletons import SMPLH
from .seen_rig import vertical_of

# Unit directions from a joint of the resting body to the next, left side; the right mirrors x
RESTING_LIMBS = {
    "hip": ("knee", (0.14, -0.99, -0.03)),
    "knee": ("ankle", (-0.11, -0.99, -0.08)),
    "shoulder": ("elbow", (0.95, -0.27, -0.16)),
    "elbow": ("wrist", (1.0, 0.09, -0.01)),
}
FOLLOWS = {"wrist": "elbow"}  # a hand lies straight on its forearm in every rest pose
PARENTS = {
    "left_hip": "pelvis", "right_hip": "pelvis", "spine1": "pelvis", "left_knee": "left_hip", "right_knee": "right_hip",
    "spine2": "spine1", "left_ankle": "left_knee", "right_ankle": "right_knee", "spine3": "spine2",
    "left_foot": "left_ankle", "right_foot": "right_ankle", "neck": "spine3", "left_collar": "spine3",
    "right_collar": "spine3", "head": "neck", "left_shoulder": "left_collar", "right_shoulder": "right_collar",
    "left_elbow": "left_shoulder", "right_elbow": "right_shoulder", "left_wrist": "left_elbow",
    "right_wrist": "right_elbow",
}  # fmt: skip
NEEDED = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "ankle", "shoulder", "elbow"))


def missing_limbs(bvh: Bvh, mapping: dict[str, int], source: str) -> None:
    """UserError when the rig's limbs cannot be told from its names."""
    missing = [joint for joint in NEEDED if joint not in mapping]
    if missing:
        raise UserError(
            f"{source}: no joint of the rig is known as {', '.join(missing)} (it has {', '.join(bvh.names[:40])}); "
            "write a mapping file {SMPL joint: joint of the rig} and give it by `mapping=FILE`"
        )


def retarget(bvh: Bvh, mapping: dict[str, int], *, up: str, scale: float, name: str, source: str) -> Motion:
    """The rig's motion as poses (T, 52, 3) and trans (T, 3) of the SMPL-H skeleton, y-up.

    mapping: rig index by SMPL-H name (`rig_names`); spine joints it lacks are taken from the chain to the shoulders.
    up: the rig world's vertical axis, x, y, z with or without a minus, or auto. scale: metres of the rig's unit, 0 for
    `leg_length`: the motion then carries the rig's leg in units that make it `Motion.leg_length` long, and a body's own
    leg takes its place when it is fitted. source: named in messages. The OFFSETs must draw a person who stands.
    """
    rest = bvh.places()[0]
    B = _stance(rest, mapping, source)
    world = bvh.world_rotations()
    track = bvh.track(mapping["pelvis"], world)
    W = _upright(bvh, world, mapping, B, up)
    turned = _limbs(bvh, mapping, rest, B)
    R = {joint: W @ world[:, j] @ turned.get(joint, B) for joint, j in mapping.items()}
    _add_spine(R, bvh, mapping, W, world, B)
    poses = _local(R, len(track))

    leg = _leg(rest, mapping)
    if not leg > 0:
        raise UserError(f"{source}: the rig's legs have no length: its OFFSETs are zero")
    factor = scale or STANDARD_LEG / leg
    trans = (track * factor) @ W.T
    return Motion(
        axis_angle_from_matrix(poses).astype(np.float32), trans.astype(np.float32), bvh.fps, name=name,
        leg_length=leg * factor,
    )  # fmt: skip


STANDARD_LEG = 0.8  # metres from hip to ankle of a mean SMPL body: what a motion is scaled to until a body is known


def _leg(rest: np.ndarray, mapping: dict[str, int]) -> float:
    sides = []
    for side in ("left", "right"):
        hip, knee, ankle = (rest[mapping[f"{side}_{part}"]] for part in ("hip", "knee", "ankle"))
        sides.append(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
    return float(np.mean(sides))


def _stance(rest: np.ndarray, mapping: dict[str, int], source: str) -> np.ndarray:
    """(3, 3) from the body's frame (left x, up y, front z) to the rig's at rest."""

    def place(part: str) -> np.ndarray:
        return (rest[mapping[f"left_{part}"]] + rest[mapping[f"right_{part}"]]) / 2

    def across(part: str) -> np.ndarray:
        return rest[mapping[f"left_{part}"]] - rest[mapping[f"right_{part}"]]

    up = place("shoulder") - place("hip")
    left = across("hip") if np.linalg.norm(across("hip")) > 1e-6 else across("shoulder")
    left = left - up * (left @ up) / max(up @ up, 1e-12)
    if np.linalg.norm(up) < 1e-6 or np.linalg.norm(left) < 1e-6:
        raise UserError(f"{source}: hips and shoulders of the rig's rest pose coincide: its OFFSETs tell no stance")
    up, left = up / np.linalg.norm(up), left / np.linalg.norm(left)
    return np.stack([left, up, np.cross(left, up)], 1)


def _snapped(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to `matrix` whose entries are -1, 0 and 1."""
    out, free = np.zeros((3, 3)), matrix.copy()
    for _ in range(2):
        i, j = np.unravel_index(np.argmax(np.abs(free)), (3, 3))
        out[i, j] = np.sign(matrix[i, j])
        free[i], free[:, j] = 0, 0
    row, column = (int(np.flatnonzero(~out.any(axis))[0]) for axis in (1, 0))
    out[row, column] = 1
    if np.linalg.det(out) < 0:
        out[row, column] = -1
    return out


def _upright(bvh: Bvh, world: np.ndarray, mapping: dict[str, int], B: np.ndarray, up: str) -> np.ndarray:
    """(3, 3) from the rig's world to the y-up one: the axis that its trunk points along on average becomes y, and a
    person at rest faces +z where that axis is the rest pose's own."""
    places = bvh.places(world)
    middle = {p: (places[:, mapping[f"left_{p}"]] + places[:, mapping[f"right_{p}"]]) / 2 for p in ("hip", "shoulder")}
    axis = vertical_of(middle["shoulder"] - middle["hip"], up)
    W = _snapped(B).T
    return W if W[1] @ axis > 0.5 else _snapped(rotation_between(W @ axis, np.array([0.0, 1, 0]))) @ W


def _limbs(bvh: Bvh, mapping: dict[str, int], rest: np.ndarray, B: np.ndarray) -> dict[str, np.ndarray]:
    """The constant part `a B` of each joint of arms and legs, (3, 3) by name."""
    out = {}
    for side, sign in (("left", 1), ("right", -1)):
        for part, (following, direction) in RESTING_LIMBS.items():
            joint, child = mapping.get(f"{side}_{part}"), mapping.get(f"{side}_{following}")
            if joint is None:
                continue
            bone = bvh.tips[joint] if child is None else rest[child] - rest[joint]
            if np.isfinite(bone).all() and np.linalg.norm(bone) > 1e-6:
                out[f"{side}_{part}"] = rotation_between(B @ (np.array(direction) * (sign, 1, 1)), bone) @ B
        for part, other in FOLLOWS.items():
            if f"{side}_{other}" in out:
                out[f"{side}_{part}"] = out[f"{side}_{other}"]
                out |= {n: out[f"{side}_{other}"] for n in mapping if n in SMPLH[22:] and n.startswith(side)}
    return out


def _spine_chain(bvh: Bvh, mapping: dict[str, int]) -> list[int]:
    """Rig joints between the pelvis and both shoulders, from the bottom up, the pelvis left out."""
    lines = [bvh.line(mapping[f"{side}_shoulder"])[:-1] for side in ("left", "right")]
    below = bvh.line(mapping["pelvis"])
    return [a for a, b in zip(*lines, strict=False) if a == b and a not in below]


def _add_spine(R: dict, bvh: Bvh, mapping: dict[str, int], W: np.ndarray, world: np.ndarray, B: np.ndarray) -> None:
    """spine1, spine2 and spine3 that the mapping lacks: the chest is the last joint below both shoulders, the others
    are taken from the chain or, where it is too short, laid between their neighbours."""
    chain = [j for j in _spine_chain(bvh, mapping) if j not in mapping.values()]
    if "spine3" not in mapping and chain:
        R["spine3"] = W @ world[:, chain[-1]] @ B
    if "spine1" not in mapping and len(chain) > 1:
        R["spine1"] = W @ world[:, chain[0]] @ B
    if "spine2" not in mapping and len(chain) > 2:
        R["spine2"] = W @ world[:, chain[len(chain) // 2]] @ B
    if "spine3" in R:
        if "spine1" not in R:
            R["spine1"] = _between(R["pelvis"], R["spine3"], 1 / 3)
        if "spine2" not in R:
            R["spine2"] = _between(R["spine1"], R["spine3"], 1 / 2)


def _between(start: np.ndarray, end: np.ndarray, fraction: float) -> np.ndarray:
    q = slerp(quaternion_from_matrix(start), quaternion_from_matrix(end), np.full(len(start), fraction))
    return matrix_from_quaternion(q)


def _parent(joint: str) -> str:
    if joint in PARENTS:
        return PARENTS[joint]
    side, finger = joint.split("_")
    return f"{side}_wrist" if finger.endswith("1") else f"{side}_{finger[:-1]}{int(finger[-1]) - 1}"


def _local(R: dict[str, np.ndarray], frames: int) -> np.ndarray:
    """(T, 52, 3, 3) relative to the parent from world orientations by name; joints without one follow their parent."""
    local = np.broadcast_to(np.eye(3), (frames, len(SMPLH), 3, 3)).copy()
    for j, joint in enumerate(SMPLH):
        if joint == "pelvis":
            local[:, j] = R[joint]
        elif joint in R:
            local[:, j] = np.swapaxes(R[_parent(joint)], -1, -2) @ R[joint]
        else:
            R[joint] = R[_parent(joint)]
    return local
