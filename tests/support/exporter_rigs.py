"""The rig of `bvh_rigs` as programs export it: names, axes, joints in between and above."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from bvh_rigs import Z_UP, bones_along, in_world

from gavatar_runtime.formats.bvh_file import Bvh

PARTS = ("UpLeg", "Leg", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand", "HandIndex1")
MIDDLE = ("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head")


def names(form: str, sides: tuple[str, str], parts: tuple[str, ...], middle: tuple[str, ...]) -> dict[str, str]:
    """Names of the rig's joints: form is filled with the side and the part, both in the order of `PARTS`."""
    out = dict(zip(MIDDLE, middle, strict=True))
    for side, short in zip(("Left", "Right"), sides, strict=True):
        out |= {f"{side}{part}": form.format(short, word) for part, word in zip(PARTS, parts, strict=True)}
    return out


def renamed(bvh: Bvh, table: dict[str, str], prefix: str = "") -> Bvh:
    """Joints that `with_twists` adds are called after the joint that they hang from."""
    parts = [name.partition("+") for name in bvh.names]
    return dataclasses.replace(bvh, names=[prefix + table.get(name, name) + twist for name, _, twist in parts])


def _with_rows(bvh: Bvh, joint: int, name: str, parent: int, offset: np.ndarray) -> Bvh:
    """A joint that never turns before row `joint`."""
    parents = np.where(bvh.parents >= joint, bvh.parents + 1, bvh.parents)
    still = np.broadcast_to(np.eye(3), (len(bvh.root), 1, 3, 3))
    return dataclasses.replace(
        bvh, names=[*bvh.names[:joint], name, *bvh.names[joint:]], parents=np.insert(parents, joint, parent),
        offsets=np.insert(bvh.offsets, joint, offset, 0), tips=np.insert(bvh.tips, joint, np.nan, 0),
        rotations=np.concatenate([bvh.rotations[:, :joint], still, bvh.rotations[:, joint:]], 1), turning=None,
    )  # fmt: skip


def under(bvh: Bvh, name: str) -> Bvh:
    """With a motionless root above: the hips keep walk and turn, as position channels below the root."""
    below = _with_rows(bvh, 0, name, -1, np.zeros(3))
    parents, offsets = below.parents.copy(), below.offsets.astype(float)
    parents[1], offsets[1] = 0, np.median(bvh.root, 0)
    return dataclasses.replace(
        below, parents=parents, offsets=offsets, moves={1: bvh.root}, root=np.zeros_like(bvh.root)
    )


def with_twists(bvh: Bvh, suffix: str, *, between: bool) -> Bvh:
    """With a joint halfway down every bone of the limbs: between its ends, or beside the bone. suffix: of its name."""
    for part in ("UpLeg", "Leg", "Arm", "ForeArm"):
        for side in ("Left", "Right"):
            j = bvh.names.index(f"{side}{part}")
            child = int(np.flatnonzero(bvh.parents == j)[0])
            half = bvh.offsets[child] / 2
            bvh = _with_rows(bvh, j + 1, f"{side}{part}+{suffix}", j, half)
            if between:
                child += 1
                parents, offsets = bvh.parents.copy(), bvh.offsets.astype(float)
                parents[child], offsets[child] = j + 1, half
                bvh = dataclasses.replace(bvh, parents=parents, offsets=offsets)
    return bvh


@dataclasses.dataclass(frozen=True)
class Exporter:
    """after: where such a file is seen. table: joints' names by ours. change: the rig's axes and further joints."""

    after: str
    table: dict[str, str]
    change: Callable[[Bvh], Bvh] = lambda bvh: bvh
    prefix: str = ""


_LR, _lr, _WORDS = ("L", "R"), ("l", "r"), ("Left", "Right")
EXPORTERS = {
    "LaFAN1": Exporter(
        "voxell-tech/bevy_motion_matching #10",
        {"LeftToeBase": "LeftToe", "RightToeBase": "RightToe"}, lambda b: bones_along(b, "x"),
    ),
    "Rokoko": Exporter("facebookresearch/AnimatedDrawings #115 #121", {}, lambda b: bones_along(b, "x", roll=90)),
    "Bandai-Namco": Exporter(
        "Wasserwecken/bvhio #11",
        names("{1}_{0}", _LR, ("UpperLeg", "LowerLeg", "Foot", "Toes", "Shoulder", "UpperArm", "LowerArm", "Hand",
                               "Index"), ("Hips", "Spine", "Chest", "UpperChest", "Neck", "Head")),
        lambda b: under(bones_along(b, "y", mirrored=True), "joint_Root"),
    ),
    "Mixamo": Exporter("YanjieZe/GMR #114", {}, prefix="mixamorig:"),
    "CMU by cgspeed": Exporter("facebookresearch/AnimatedDrawings #179", {
        "Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1", "LeftHandIndex1": "LeftFingerBase",
        "RightHandIndex1": "RightFingerBase",
    }),
    "Unreal": Exporter(
        "Mwni/blender-animation-retargeting #2",
        names("{1}_{0}", _lr, ("thigh", "calf", "foot", "ball", "clavicle", "upperarm", "lowerarm", "hand",
                               "index_01"), ("pelvis", "spine_01", "spine_02", "spine_03", "neck_01", "head")),
        lambda b: under(in_world(with_twists(bones_along(b, "x", mirrored=True), "_twist_01", between=False), Z_UP),
                        "root"),
    ),
    "Xsens": Exporter(
        "YanjieZe/GMR #87",
        names("{}{}", _WORDS, ("Hip", "Knee", "Ankle", "Toe", "Collar", "Shoulder", "Elbow", "Wrist", "Finger"),
              ("Hips", "Chest", "Chest2", "Chest4", "Neck", "Head")),
    ),
    "Perception Neuron": Exporter("facebookresearch/AnimatedDrawings #140", {}, prefix="Robot_"),
    "Rigify": Exporter(
        "NVlabs/GEM-X #17",
        names("DEF-{1}.{0}", _LR, ("thigh", "shin", "foot", "toe", "shoulder", "upper_arm", "forearm", "hand",
                                   "f_index.01"), ("DEF-spine", *(f"DEF-spine.00{n}" for n in (1, 2, 3, 4, 6)))),
        lambda b: with_twists(bones_along(b, "y"), ".001", between=True),
    ),
    "Auto-Rig Pro": Exporter(
        "xNoRain001/auto-rig",
        names("{1}.{0}", _lr, ("thigh_stretch", "leg_stretch", "foot", "toes_01", "shoulder", "arm_stretch",
                               "forearm_stretch", "hand", "c_index1"),
              ("root.x", "spine_01.x", "spine_02.x", "spine_03.x", "neck.x", "head.x")),
        lambda b: with_twists(bones_along(b, "y", roll=90), "_twist", between=False),
    ),
    "DAZ": Exporter(
        "upf-gti/retargeting-threejs #3",
        names("{}{}", _lr, ("ThighBend", "Shin", "Foot", "Toe", "Collar", "ShldrBend", "ForearmBend", "Hand", "Index1"),
              ("hip", "abdomenLower", "abdomenUpper", "chestUpper", "neckLower", "head")),
    ),
    "SOMA": Exporter(
        "nv-tlabs/kimodo #15",
        names("{}{}", _WORDS, ("Leg", "Shin", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand", "HandIndex1"),
              ("Hips", "Spine1", "Spine2", "Chest", "Neck1", "Head")),
        lambda b: under(bones_along(b, "x", mirrored=True, roll=90), "Root"),
    ),
    "glTF by way of a converter": Exporter(
        "huangruoqi/PANDA", {name: f"{name}_{j:02d}" for j, name in enumerate(
            [*MIDDLE, *(f"{s}{p}" for s in _WORDS for p in PARTS)])},
    ),
}  # fmt: skip
