"""Which joint of somebody's rig is which joint of the SMPL family, told by their names."""

from __future__ import annotations

import collections
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import UserError, cannot_read, did_you_mean
from ..values.skeletons import SMPLH

# After the side and any prefix are taken off, lower case, letters and digits only. The first that the rig has is taken.
LIMBS = {
    "hip": ("upleg", "upperleg", "upperlegs", "thigh", "femur", "hip"),
    "knee": ("lowleg", "lowerleg", "lowerlegs", "shin", "calf", "knee", "tibia", "leg"),
    "ankle": ("ankle", "foot"),
    "foot": ("toebase", "toe", "toe0", "toes", "ball", "foot"),
    "collar": ("collar", "clavicle", "scapula", "thorax", "shoulder"),
    "shoulder": ("upperarm", "uparm", "uarm", "arm", "humerus", "shldr", "shoulder"),
    "elbow": ("forearm", "lowerarm", "lowarm", "farm", "elbow", "radius"),
    "wrist": ("wrist", "hand"),
}
CENTRE = {
    "neck": ("neck", "neck1", "neck01", "lowerneck", "necklower", "necktwist01"),
    "head": ("head", "head1", "head01"),
}
FINGER_NAMES = {
    "index": "index",
    "middle": "middle|mid",
    "ring": "ring",
    "pinky": "pinky|pinkie|little",
    "thumb": "thumb",
}
_SEPARATORS = r"[_\s.\-]"
_PREFIX = re.compile(
    rf"^(mixamorig\d*|character\d*|bip\d*|valvebiped|armature|def|org|c|j|jnt|joint|bone|bn|b|cc_base|m_avg){_SEPARATORS}+",
    re.I,
)
_MIDDLE = re.compile(rf"^(c|m|x|mid|center|centre){_SEPARATORS}+|{_SEPARATORS}+(c|m|x|mid|center|centre)$", re.I)
_WORDS = sorted({word for words in LIMBS.values() for word in words}, key=len, reverse=True)
_OF_LIMBS = re.compile(r"(stretch|bend|fk|bone|0*1)$")  # the first of several bones of a limb, or of a control rig's
_NUMBERED = re.compile(r"_\d{1,4}$")  # as converters of glTF number the joints
_SHINS = ("lowleg", "lowerleg", "lowerlegs", "shin", "calf", "knee", "tibia")
_SHARED = 0.7  # of the names of a rig have what is taken for its prefix


def split_name(name: str) -> tuple[str, str]:
    """A rig's joint name -> its side (`left`, `right` or ``) and what it is: lower case, letters and digits only.

    Prefixes such as `mixamorig:`, `Character1_` or `Bip01 ` are dropped. `LeftUpLeg`, `lThigh`, `thigh.L`, `l_thigh`,
    `thigh_l`, `Bip01 L Thigh`, `J_Bip_L_UpperLeg` and `lfemur` all have the side left.
    """
    bare = re.sub(r"^.*[:|]", "", name.strip())
    bare = re.sub(r"^mixamorig", "", _without_prefixes(bare))
    for side, word, letter in (("left", "left", "l"), ("right", "right", "r")):
        found = (
            re.fullmatch(rf"(?i:{word}){_SEPARATORS}*(.*)", bare)
            or re.fullmatch(rf"(.*?){_SEPARATORS}*(?i:{word})", bare)
            or re.fullmatch(rf"(?i:{letter}){_SEPARATORS}+(.*)", bare)
            or re.fullmatch(rf"(.*?){_SEPARATORS}+(?i:{letter})(?:[_.\-]\d+)?", bare)
            or re.fullmatch(rf"[{letter}{letter.upper()}]([A-Z].*)", bare)
            or re.fullmatch(rf"{letter}({'|'.join(_WORDS)})", bare)
            or re.fullmatch(rf"(.*[a-z]){letter.upper()}", bare)
        )
        if found and found[1]:
            return side, _plain(found[1])
    return "", _plain(_MIDDLE.sub("", bare))


def _plain(what: str) -> str:
    return re.sub(r"[^a-z0-9]", "", what.lower())


def _without_prefixes(name: str) -> str:
    while True:
        shorter = _PREFIX.sub("", name)
        if shorter in (name, ""):
            return name
        name = shorter


def bare_names(names: list[str]) -> list[str]:
    """The names without a beginning or an end, up to a separator, that most of them share: `Robot_LeftArm`, `Hips_jnt`.

    A side is never taken off. Names that lack it stay as they are. Numbers that every name but a few ends with, and
    that no other name shares, go too.
    """
    short = [_NUMBERED.sub("", name) for name in names]
    numbered = [name for name, bare in zip(names, short, strict=True) if name != bare]
    if len(numbered) >= _SHARED * len(names) and len(set(numbered)) == len(numbered) and len(set(short)) == len(names):
        names = short
    start, end = _shared_start(names), _shared_start([name[::-1] for name in names])[::-1]
    bare = [name.removeprefix(start) or name for name in names]
    return [name.removesuffix(end) or name for name in bare]


def _shared_start(names: list[str]) -> str:
    start, longest = "", ""
    while True:
        following = collections.Counter(n[len(start)] for n in names if n.startswith(start) and len(n) > len(start))
        letter, count = following.most_common(1)[0] if following else ("", 0)
        if not letter or count < _SHARED * len(names):
            break
        start += letter
        if re.fullmatch(r"[:|_\s.\-]", letter):
            longest = start
    if not longest and len(names) > 3 and all(name.startswith(start) for name in names):
        longest = start  # `RobotHips`: nothing divides it, but every name has it
    sides = re.split(r"[:|_\s.\-]", longest.lower())
    return "" if {"l", "r", "left", "right", "tfel", "thgir"} & set(sides) else longest


def match_rig(names: list[str], parents: Sequence[int] | np.ndarray | None) -> dict[str, int]:
    """SMPL-H joint name -> index in the rig, for the joints that the names tell; always holds `pelvis`: the joint that
    both legs hang from, whatever it and those above it are called.

    The spine is not here: its joints differ in number, not in name (see `retarget`). A `Shoulder` is a collar bone
    where the rig also has an upper arm, and the upper arm where it has a collar bone.
    """
    split = [split_name(name) for name in bare_names(names)]
    found: dict[str, int] = {"pelvis": 0}
    for side in ("left", "right"):
        mine = {what: j for j, (s, what) in reversed(list(enumerate(split))) if s == side}
        for what, j in list(mine.items()):  # `upperleg01`, `thighbend`
            mine.setdefault(_OF_LIMBS.sub("", what), j)
        if "leg" in mine and set(_SHINS) & set(mine):
            mine.setdefault("upleg", mine["leg"])
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
    if parents is not None:
        found |= _neck_and_head(found, split, parents)
    return found | {"pelvis": pelvis_of(found, parents)}


def _neck_and_head(
    found: dict[str, int], split: list[tuple[str, str]], parents: Sequence[int] | np.ndarray
) -> dict[str, int]:
    """Neck and head that have no such name (`spine.006`): the first and the last of the longest row of joints in the
    middle that leaves the spine above the hips, if it leaves it at the shoulders' last common joint."""
    if ("neck" in found and "head" in found) or not {"left_shoulder", "right_shoulder"} <= set(found):
        return {}
    lines = [_line(found[f"{side}_shoulder"], parents) for side in ("left", "right")]
    chest = next((joint for joint in lines[0] if joint in lines[1]), -1)
    rows = [_line(j, parents)[::-1] for j in range(len(parents)) if chest in _line(j, parents)[1:]]
    rows = [row[row.index(chest) + 1 :] for row in rows]
    rows = [row for row in rows if not any(split[j][0] for j in row) and not set(row) & set(lines[0] + lines[1])]
    row = max(rows, key=len, default=[])
    if "head" in found or not row:
        line = _line(found["head"], parents)[::-1] if "head" in found else []
        row = line[line.index(chest) + 1 :] if chest in line else []
        return {"neck": row[0]} if len(row) > 1 and "neck" not in found else {}
    if "neck" in found:
        row = row[row.index(found["neck"]) + 1 :] if found["neck"] in row else []
        return {"head": row[-1]} if row else {}
    return {"head": row[-1]} | ({"neck": row[0]} if len(row) > 1 else {})


def _line(joint: int, parents: Sequence[int] | np.ndarray) -> list[int]:
    """The joint and those above it, to the root."""
    line = []
    while joint >= 0:
        line.append(int(joint))
        joint = int(parents[joint])
    return line


def pelvis_of(found: dict[str, int], parents: Sequence[int] | np.ndarray | None) -> int:
    """The lowest joint above both hips, 0 where they are not known."""
    if parents is None or not {"left_hip", "right_hip"} <= set(found):
        return 0
    lines = [_line(int(parents[found[hip]]), parents) for hip in ("left_hip", "right_hip")]
    return next((joint for joint in lines[0] if joint in lines[1]), 0)


def _fingers(mine: dict[str, int]) -> dict[str, int]:
    out: dict[str, int] = {}
    for finger, words in FINGER_NAMES.items():
        for what, j in mine.items():
            match = re.fullmatch(rf"(?:hand|finger|f)?(?:{words})(?:finger)?(?:proximal|meta)?0?(\d?)", what)
            if match and 1 <= int(match[1] or 1) <= 3:
                out.setdefault(f"{finger}{match[1] or 1}", j)
    return out


def read_mapping(path: str | os.PathLike, names: list[str]) -> dict[str, int]:
    """A mapping file: a JSON object {SMPL-H joint name: joint name in the rig}, null to leave one out.

    Returns rig indices by SMPL-H name, -1 for null. Raises UserError naming the file and the entry.
    """
    path = Path(path)
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise cannot_read(f"mapping file {path}", error) from None
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
