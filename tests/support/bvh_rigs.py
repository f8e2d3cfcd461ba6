"""BVH files of rigs that are known to the last bone, and the same motions in rigs with other axes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gavatar_runtime.formats.bvh_file import Bvh
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle

# name, parent, offset in a y-up T-pose that faces +z, left at +x; units of a hundredth of a metre
MIXAMO = [
    ("Hips", None, (0, 95, 0)), ("Spine", "Hips", (0, 10, 0)), ("Spine1", "Spine", (0, 12, 0)),
    ("Spine2", "Spine1", (0, 12, 0)), ("Neck", "Spine2", (0, 18, 0)), ("Head", "Neck", (0, 8, 2)),
    *(
        entry
        for side, x in (("Left", 1), ("Right", -1))
        for entry in (
            (f"{side}Shoulder", "Spine2", (6 * x, 12, 0)), (f"{side}Arm", f"{side}Shoulder", (12 * x, 0, 0)),
            (f"{side}ForeArm", f"{side}Arm", (27 * x, 0, 0)), (f"{side}Hand", f"{side}ForeArm", (25 * x, 0, 0)),
            (f"{side}HandIndex1", f"{side}Hand", (9 * x, 0, 2)),
            (f"{side}UpLeg", "Hips", (9 * x, -5, 0)), (f"{side}Leg", f"{side}UpLeg", (0, -42, 0)),
            (f"{side}Foot", f"{side}Leg", (0, -41, 0)), (f"{side}ToeBase", f"{side}Foot", (0, -7, 12)),
        )
    ),
]  # fmt: skip

CMU_NAMES = {
    "Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1", "LeftHandIndex1": "LeftFingerBase",
    "RightHandIndex1": "RightFingerBase",
}  # fmt: skip

POSER_NAMES = {
    "Hips": "hip", "Spine": "abdomen", "Spine1": "chest", "Spine2": "chest2", "Neck": "neck", "Head": "head",
    **{
        f"{side}{a}": f"{letter}{b}"
        for side, letter in (("Left", "l"), ("Right", "r"))
        for a, b in {
            "Shoulder": "Collar", "Arm": "Shldr", "ForeArm": "ForeArm", "Hand": "Hand", "UpLeg": "Thigh", "Leg": "Shin",
            "Foot": "Foot", "ToeBase": "Toe", "HandIndex1": "Index1",
        }.items()
    },
}  # fmt: skip

ORDER = "ZXY"


def write_bvh(path, angles, root, *, world=None, lowered=0.0, rename=None, prefix="", unit=1.0, fps=30):
    """A BVH file of the rig above. angles: (T, J, 3) degrees about Z, X, Y. world: (3, 3) from its axes to the file's.
    lowered: degrees that the rest pose's arms hang. Returns (names, offsets) as they stand in the file."""
    world = np.eye(3) if world is None else world
    children: dict = {}
    for name, parent, _ in MIXAMO:
        children.setdefault(parent, []).append(name)
    offsets = {}
    for name, _, offset in MIXAMO:
        offset = np.array(offset, float)
        if any(part in name for part in ("ForeArm", "Hand")):
            sign = -1 if name.startswith("Left") else 1
            offset = matrix_from_axis_angle(np.radians([0, 0, sign * lowered])) @ offset
        offsets[name] = world @ offset * unit
    called = {n: prefix + (rename or {}).get(n, n) for n, _, _ in MIXAMO}
    lines, order = ["HIERARCHY"], []

    def joint(name, depth):
        pad = "  " * depth
        order.append(name)
        channels = "6 Xposition Yposition Zposition" if depth == 0 else "3"
        lines.append(f"{pad}{'JOINT' if depth else 'ROOT'} {called[name]}")
        lines.append(f"{pad}{{")
        lines.append(f"{pad}  OFFSET {' '.join(f'{v:.6f}' for v in offsets[name])}")
        lines.append(f"{pad}  CHANNELS {channels} " + " ".join(f"{a}rotation" for a in ORDER))
        for child in children.get(name, []):
            joint(child, depth + 1)
        if name not in children:
            lines.extend([f"{pad}  End Site", f"{pad}  {{", f"{pad}    OFFSET 0 1 0", f"{pad}  }}"])
        lines.append(f"{pad}}}")

    joint("Hips", 0)
    lines += ["MOTION", f"Frames: {len(angles)}", f"Frame Time: {1 / fps:.8f}"]
    index = [[n for n, _, _ in MIXAMO].index(name) for name in order]
    for row, place in zip(angles, root, strict=True):
        place = world @ np.asarray(place, float) * unit
        lines.append(" ".join(f"{v:.6f}" for v in [*place, *row[index].reshape(-1)]))
    Path(path).write_text("\n".join(lines) + "\n")


Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # x stays, y becomes z

NEXT = {"hip": "knee", "knee": "ankle", "shoulder": "elbow", "elbow": "wrist"}

RIGS = {
    "Mixamo, y-up, cm": {"prefix": "mixamorig:"},
    "CMU, arms hanging, inches": {"rename": CMU_NAMES, "lowered": 85.0, "unit": 1 / 2.54},
    "z-up, metres, A-pose": {"world": Z_UP, "lowered": 40.0, "unit": 0.01},
    "Poser": {"rename": POSER_NAMES},
}


def random_angles(frames, seed=0, scale=25):
    angles = np.random.default_rng(seed).normal(0, scale, (frames, len(MIXAMO), 3))
    angles[:, 0] *= 0.5  # upright on average
    return angles


def directions(places, name, following):
    bone = places[:, following] - places[:, name]
    return bone / np.linalg.norm(bone, axis=-1, keepdims=True)


def zxy_degrees(R: np.ndarray) -> np.ndarray:
    """(..., 3) angles about Z, X and Y, applied in that order about the turned axes, of rotations (..., 3, 3)."""
    z, x = np.arctan2(-R[..., 0, 1], R[..., 1, 1]), np.arcsin(np.clip(R[..., 2, 1], -1, 1))
    y = np.arctan2(-R[..., 2, 0], R[..., 2, 2])
    locked = np.abs(R[..., 2, 1]) > 1 - 1e-12  # z and y turn about one axis: all of it is z
    z, y = np.where(locked, np.arctan2(R[..., 1, 0], R[..., 0, 0]), z), np.where(locked, 0, y)
    return np.degrees(np.stack([z, x, y], -1))


def reaxed(bvh: Bvh, S: np.ndarray) -> Bvh:
    """The same motion in a rig whose joints' axes, and so its OFFSETs, are turned by S (J, 3, 3), old axes of the new:
    at rest no person."""
    world = bvh.world_rotations() @ S
    local, offsets = world.copy(), bvh.offsets.astype(float)
    for j, parent in enumerate(bvh.parents):
        if parent >= 0:
            local[:, j] = np.swapaxes(world[:, parent], -1, -2) @ world[:, j]
            offsets[j] = S[parent].T @ bvh.offsets[j]
    return dataclasses.replace(bvh, rotations=local, offsets=offsets, tips=np.einsum("jba,jb->ja", S, bvh.tips))


def in_world(bvh: Bvh, turn: np.ndarray) -> Bvh:
    """The same motion in a world turned by (3, 3), the OFFSETs as they are."""
    rotations = bvh.rotations.copy()
    rotations[:, 0] = turn @ rotations[:, 0]
    return dataclasses.replace(bvh, rotations=rotations, root=bvh.root @ turn.T)


def scrambled(bvh: Bvh, seed: int = 0) -> Bvh:
    """In a rig whose joints' axes are turned at random."""
    turns = np.random.default_rng(seed).normal(0, 2, (len(bvh.names), 3))
    return reaxed(bvh, matrix_from_axis_angle(turns))


def bones_along(bvh: Bvh, axis: str, *, mirrored: bool = False, roll: float = 0.0) -> Bvh:
    """In a rig whose bones all lie along an axis of their joint, x, y or z, those of the right side against it where
    mirrored; another axis lies, as near as may be, in front, or turned from there by `roll` degrees about the bone."""
    S = np.zeros((len(bvh.names), 3, 3))
    for j, name in enumerate(bvh.names):
        children = np.flatnonzero(bvh.parents == j)
        bone = bvh.offsets[children[0]] if len(children) else bvh.tips[j]
        bone = bone / np.linalg.norm(bone) if np.isfinite(bone).all() and np.linalg.norm(bone) > 1e-6 else np.eye(3)[1]
        front = np.eye(3)[2] if abs(bone[2]) < 0.9 else np.eye(3)[1]
        front = front - bone * (front @ bone)
        front = matrix_from_axis_angle(np.radians(roll) * bone) @ (front / np.linalg.norm(front))
        main = -bone if mirrored and "Right" in name else bone
        k = "xyz".index(axis)
        S[j][:, k], S[j][:, (k + 1) % 3], S[j][:, (k + 2) % 3] = main, front, np.cross(main, front)
    return reaxed(bvh, S)


def write_parsed(path, bvh):
    """A parsed file as text again."""
    children = {j: [k for k, p in enumerate(bvh.parents) if p == j] for j in range(-1, len(bvh.names))}
    lines, order = ["HIERARCHY"], []

    def joint(j):
        order.append(j)
        lines.extend([f"{'JOINT' if bvh.parents[j] >= 0 else 'ROOT'} {bvh.names[j]}", "{"])
        lines.append("OFFSET " + " ".join(f"{v:.9f}" for v in bvh.offsets[j]))
        places = "6 Xposition Yposition Zposition" if bvh.parents[j] < 0 or j in bvh.moves else "3"
        lines.append(f"CHANNELS {places} Zrotation Xrotation Yrotation")
        for child in children[j]:
            joint(child)
        if np.isfinite(bvh.tips[j]).all():
            lines.extend(["End Site", "{", "OFFSET " + " ".join(f"{v:.9f}" for v in bvh.tips[j]), "}"])
        lines.append("}")

    joint(children[-1][0])
    angles = zxy_degrees(bvh.rotations)
    columns = []
    for j in order:
        places = bvh.root if bvh.parents[j] < 0 else bvh.moves.get(j)
        columns += [angles[:, j]] if places is None else [places, angles[:, j]]
    table = np.concatenate(columns, 1)
    lines += ["MOTION", f"Frames: {len(bvh.root)}", f"Frame Time: {1 / bvh.fps:.8f}"]
    lines += [" ".join(f"{v:.9f}" for v in row) for row in table]
    Path(path).write_text("\n".join(lines) + "\n")
