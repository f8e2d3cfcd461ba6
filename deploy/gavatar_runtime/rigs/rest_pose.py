"""In which pose the person of a BVH file stands at rest: what its rotations are relative to.

Most rigs stand in the pose that their OFFSETs draw. Some (LaFAN1, Bandai-Namco, Rokoko) lay every bone along one of the
joint's own axes instead, so that the OFFSETs draw nobody; then the rest pose is looked for in the frames.
"""

from __future__ import annotations

import numpy as np

from ..errors import UserError
from ..formats.bvh_file import Bvh
from .rig_anatomy import facing_ahead, imagined_stance

RESTS = ("auto", "offsets", "first-frame", "anatomy")
_SIDES = ("left", "right")


def with_rest_pose(bvh: Bvh, mapping: dict[str, int], rest: str, up: str, source: str) -> tuple[Bvh, str, str]:
    """The motion with OFFSETs that draw a standing person, which rest pose that is (one of `RESTS`), and why.

    rest: `auto` takes the OFFSETs where they draw a person who stands, else the first frame where it shows one in a
    T-pose, else the stance that the skeleton's anatomy tells (`anatomy.imagined_stance`). mapping: rig index by SMPL-H
    name. up: the vertical axis of the rig's world, as in `retarget`.
    """
    if rest == "offsets":
        return bvh, rest, "as asked"
    if rest == "first-frame":
        return bvh.rested(bvh.world_rotations()[0]), rest, "as asked"
    why = "as asked"
    if rest == "auto":
        fault = fault_of_stance(bvh.places()[0], mapping)
        if not fault:
            return bvh, "offsets", "the OFFSETs draw a person who stands"
        if is_t_pose(bvh.places(bvh.world_rotations()[:1])[0], mapping):
            why = f"the OFFSETs draw nobody who stands ({fault}), frame 0 a T-pose"
            return bvh.rested(facing_ahead(bvh, mapping, up)), "first-frame", why
        why = f"the OFFSETs draw nobody who stands ({fault}), nor is frame 0 a T-pose"
    start = imagined_stance(bvh, mapping, up)
    if start is None:
        raise UserError(f"{source}: hips and shoulders of the rig coincide: no pose of it tells how it stands")
    return bvh.rested(start), "anatomy", why


def fault_of_stance(places: np.ndarray, mapping: dict[str, int]) -> str:
    """What is wrong with one pose, places (J, 3), as that of somebody who stands; `` for nothing. Arms may be anywhere
    as long as both are alike."""
    at = {name: places[j] for name, j in mapping.items()}
    hips, shoulders = ((at[f"left_{p}"] + at[f"right_{p}"]) / 2 for p in ("hip", "shoulder"))
    up = shoulders - hips
    across = _unit(at["left_hip"] - at["right_hip"]) + _unit(at["left_shoulder"] - at["right_shoulder"])
    left = across - up * (across @ up) / max(up @ up, 1e-12)
    if np.linalg.norm(up) < 1e-6 or np.linalg.norm(left) < 1e-6:
        return "hips and shoulders coincide"
    legs, arms = ({s: at[f"{s}_{end}"] - at[f"{s}_{start}"] for s in _SIDES} for start, end in
                  (("hip", "ankle"), ("shoulder", "elbow")))  # fmt: skip
    for side in _SIDES:
        if _angle(legs[side], -up) > 70:
            return f"the {side} leg points {'up' if _angle(legs[side], up) < 60 else 'aside'}"
        if _angle(at[f"{side}_knee"] - at[f"{side}_hip"], at[f"{side}_ankle"] - at[f"{side}_knee"]) > 70:
            return f"the {side} knee is folded"
    mirror = np.eye(3) - 2 * np.outer(_unit(left), _unit(left))
    for limb, part in (("arm", arms), ("leg", legs)):
        if _angle(mirror @ part["left"], part["right"]) > 45:
            return f"the {limb}s are not alike"
    top = at.get("head", at.get("neck"))
    if top is not None and _angle(top - shoulders, up) > 100:
        return "the head hangs"
    if "left_foot" in at and "right_foot" in at:
        shins = [_angle(at[f"{s}_foot"] - at[f"{s}_ankle"], at[f"{s}_ankle"] - at[f"{s}_knee"]) for s in _SIDES]
        if max(shins) < 15 and np.linalg.norm(at["left_foot"] - at["left_ankle"]) > 0.1 * np.linalg.norm(legs["left"]):
            return "the feet point along the shins"
    return ""


def is_t_pose(places: np.ndarray, mapping: dict[str, int]) -> bool:
    """Whether one pose, places (J, 3), is a T-pose: legs straight down, arms straight to the sides, within 5 degrees,
    as exporters put it before a motion; an actor's is less exact than what anatomy tells."""
    if fault_of_stance(places, mapping) not in ("", "the feet point along the shins"):
        return False
    at = {name: places[j] for name, j in mapping.items()}
    up = at["left_shoulder"] + at["right_shoulder"] - at["left_hip"] - at["right_hip"]
    aside = at["left_shoulder"] - at["right_shoulder"]
    aside = aside - up * (aside @ up) / (up @ up)
    bones = {("hip", "knee"): -up, ("knee", "ankle"): -up, ("shoulder", "elbow"): aside, ("elbow", "wrist"): aside}
    for (start, end), direction in bones.items():
        for side, sign in (("left", 1), ("right", -1)):
            if f"{side}_{end}" in at:
                sign = 1 if direction is not aside else sign
                if _angle(at[f"{side}_{end}"] - at[f"{side}_{start}"], sign * direction) > 5:
                    return False
    return True


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(np.linalg.norm(vector), 1e-12)


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    """Degrees between two directions; 0 where one has no length."""
    lengths = np.linalg.norm(one) * np.linalg.norm(other)
    return 0.0 if lengths < 1e-12 else float(np.degrees(np.arccos(np.clip(one @ other / lengths, -1, 1))))
