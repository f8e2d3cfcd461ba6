"""Which joint of somebody's rig is which joint of the SMPL family, told by their names."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from ..errors import UserError, did_you_mean
from ..values.skeletons import FINGERS, SMPLH

# After the side and any prefix are taken off, lower case, letters and digits only. The first that the rig has is taken.
LIMBS = {
    "hip": ("upleg", "upperleg", "upperlegs", "thigh", "femur", "hip"),
    "knee": ("lowleg", "lowerleg", "lowerlegs", "shin", "calf", "knee", "tibia", "leg"),
    "ankle": ("foot", "ankle"),
    "foot": ("toebase", "toe", "toe0", "toes", "ball"),
    "collar": ("collar", "clavicle", "shoulder"),
    "shoulder": ("upperarm", "uparm", "arm", "humerus", "shldr", "shoulder"),
    "elbow": ("forearm", "lowerarm", "lowarm", "elbow", "radius"),
    "wrist": ("hand", "wrist"),
}
CENTRE = {"neck": ("neck", "neck1", "neck01", "lowerneck"), "head": ("head",)}
FINGER_NAMES = {
    "index": "index",
    "middle": "middle|mid",
    "ring": "ring",
    "pinky": "pinky|pinkie|little",
    "thumb": "thumb",
}


def split_name(name: str) -> tuple[str, str]:
    """A rig's joint name -> its side (`left`, `right` or ``) and what it is: lower case, letters and digits only.

    Prefixes such as `mixamorig:`, `Character1_` or `Bip01 ` are dropped. `LeftUpLeg`, `lThigh`, `thigh.L`, `l_thigh`,
    `thigh_l` and `Bip01 L Thigh` all have the side left.
    """
    bare = re.sub(r"^.*[:|]", "", name.strip())
    bare = re.sub(
        r"^(mixamorig\d*|character\d+|bip\d*|valvebiped|armature|def|j|bn|cc_base|m_avg)[_\s.\-]+", "", bare, flags=re.I
    )
    bare = re.sub(r"^mixamorig", "", bare)
    for side, word, letter in (("left", "left", "l"), ("right", "right", "r")):
        found = (
            re.fullmatch(rf"(?i:{word})[_\s.\-]*(.*)", bare)
            or re.fullmatch(rf"(.*?)[_\s.\-]*(?i:{word})", bare)
            or re.fullmatch(rf"(?i:{letter})[_\s.\-]+(.*)", bare)
            or re.fullmatch(rf"(.*?)[_\s.\-]+(?i:{letter})(?:[_.\-]\d+)?", bare)
            or re.fullmatch(rf"[{letter}{letter.upper()}]([A-Z].*)", bare)
        )
        if found and found[1]:
            return side, re.sub(r"[^a-z0-9]", "", found[1].lower())
    return "", re.sub(r"[^a-z0-9]", "", bare.lower())


def match_rig(names: list[str], parents) -> dict[str, int]:
    """SMPL-H joint name -> index in the rig, for the joints that the names tell; always holds `pelvis`, the root.

    The spine is not here: its joints differ in number, not in name (see `retarget`). A `Shoulder` is a collar bone
    where the rig also has an upper arm, and the upper arm where it has a collar bone.
    """
    split = [split_name(name) for name in names]
    found: dict[str, int] = {"pelvis": 0}
    for side in ("left", "right"):
        mine = {what: j for j, (s, what) in reversed(list(enumerate(split))) if s == side}
        taken: set[int] = set()
        for part in ("shoulder", "hip", "collar", *(p for p in LIMBS if p not in ("shoulder", "hip", "collar"))):
            words = LIMBS[part]
            if part == "collar" and found.get(f"{side}_shoulder") == mine.get("shoulder"):
                words = words[:-1]
            choice = next((mine[w] for w in words if w in mine and mine[w] not in taken), None)
            if choice is not None:
                found[f"{side}_{part}"] = choice
                taken.add(choice)
        found |= {f"{side}_{name}": j for name, j in _fingers(mine).items()}
    for part, words in CENTRE.items():
        choice = next((j for w in words for j, (s, what) in enumerate(split) if not s and what == w), None)
        if choice is not None:
            found[part] = choice
    return found


def _fingers(mine: dict[str, int]) -> dict[str, int]:
    out = {}
    for finger, words in FINGER_NAMES.items():
        for what, j in mine.items():
            match = re.fullmatch(rf"(?:hand|finger|f)?(?:{words})(?:finger)?(?:proximal|meta)?0?(\d)", what)
            if match and 1 <= int(match[1]) <= 3:
                out[f"{finger}{match[1]}"] = j
    return out


def read_mapping(path: str | os.PathLike, names: list[str]) -> dict[str, int]:
    """A mapping file: a JSON object {SMPL-H joint name: joint name in the rig}, null to leave one out.

    Returns rig indices by SMPL-H name, -1 for null. Raises UserError naming the file and the entry.
    """
    path = Path(path)
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"mapping file {path} cannot be read: {error.strerror or error}") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"mapping file {path} is not valid JSON: {error}") from None
    if not isinstance(entries, dict):
        raise UserError(f"mapping file {path} must hold an object: {{SMPL joint: joint of the rig}}")
    mapping = {}
    for joint, name in entries.items():
        if joint not in SMPLH:
            raise UserError(f"mapping file {path}: unknown joint '{joint}': {did_you_mean(joint, SMPLH)}")
        if name is not None and name not in names:
            raise UserError(
                f"mapping file {path}: the rig has no '{name}' for {joint}: {did_you_mean(str(name), names)}"
            )
        mapping[joint] = -1 if name is None else names.index(name)
    return mapping


__all__ = ["FINGERS", "match_rig", "read_mapping", "split_name"]
