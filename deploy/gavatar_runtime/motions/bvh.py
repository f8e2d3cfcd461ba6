"""Motion capture in BVH files, retargeted by the names of their joints."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError, WrongValue
from ..formats.bvh_file import Bvh, read_bvh
from ..rigs.rest_pose import RESTS, with_rest_pose
from ..rigs.retarget import NEEDED, missing_limbs, retarget
from ..rigs.rig_names import match_rig, pelvis_of, read_mapping
from ..values.motion import Motion
from .plausible import FULL_TURN, UNITS, asked_rate, check_way, stated_rate
from .source import MOTIONS, MotionSource

ANGLES = ("degrees", "radians")
_WIDEST = 1e5  # degrees: no file counts so many turns
AXES = ("auto", "x", "y", "z", "-x", "-y", "-z")


@dataclasses.dataclass
class BvhOptions:
    """up: the file's vertical axis; auto takes the one that the trunk points along on average. units: auto, m, cm, mm,
    inch or ft; auto scales the walk by the legs of the body that plays it. mapping: a JSON file {SMPL joint: joint of
    the rig} for rigs whose names are not known. fps: overrides the file's, 0 keeps it. rest: the person stands at rest
    in the pose that the `offsets` draw, in the `first-frame`, or in a T-pose that `anatomy` tells; `auto` chooses.
    angles: what they are in, `degrees` or `radians`."""

    up: str = "auto"
    rest: str = "auto"
    units: str = "auto"
    mapping: str = ""
    fps: float = 0.0
    angles: str = "degrees"


@MOTIONS.register("bvh", config=BvhOptions, summary="BVH, retargeted by joint names (CMU, Mixamo and other rigs)")
class BvhFile(MotionSource):
    """A file of one person, 52 SMPL-H joints when read. facts: which rest pose was taken and why, once it is read."""

    suffixes = (".bvh",)

    def __init__(self, config: BvhOptions, *, path: Path):
        for name, known in (("up", AXES), ("rest", RESTS), ("units", UNITS), ("angles", ANGLES)):
            if getattr(config, name) not in known:
                raise WrongValue(f"`{name}={getattr(config, name)}`: choose from {', '.join(known)}")
        self.config, self.path = config, path
        self.rate = asked_rate(config.fps)
        self.facts: dict[str, str] = {}

    def load(self) -> Motion:
        """The motion, y-up; UserError naming the file and what is wrong."""
        bvh = read_bvh(self.path, radians=self.config.angles == "radians")
        rate = self.rate or stated_rate(self.path, "Frame Time", bvh.fps, len(bvh.root))
        mapping = self._mapping(bvh)
        missing_limbs(bvh, mapping, str(self.path))
        notes = self._doubts(bvh, mapping)
        bvh, rest, why = with_rest_pose(bvh, mapping, self.config.rest, self.config.up, str(self.path))
        self.facts = {"rest pose": f"{rest}: {why}"}
        scale = UNITS[self.config.units]
        motion = retarget(bvh, mapping, up=self.config.up, scale=scale, name=self.path.stem, source=str(self.path))
        if self.config.rest == "auto" and rest != "offsets":
            notes.append(f"rest pose {rest}: {why}; `rest` says another")
        notes += [
            f"{note}: the positions may be in another unit than the OFFSETs; `units=cm` (or what they are in) keeps "
            "them"
            for note in check_way(motion.trans, rate) if scale == 0
        ]  # fmt: skip
        kept: dict[str, Any] = {} if scale == 0 else {"leg_length": None}
        return dataclasses.replace(motion, fps=rate, notes=(*bvh.notes, *notes), **kept)

    def _doubts(self, bvh: Bvh, mapping: dict[str, int]) -> list[str]:
        """Notes on channels that a motion of a person hardly has; UserError where they tell no pose at all."""
        limbs = [mapping[name] for name in NEEDED]
        if bvh.turning is not None and not bvh.turning[limbs].any():
            if any(joint in bvh.moves for joint in limbs):
                raise UserError(
                    f"{self.path} holds positions of joints and no rotations of its limbs: a motion needs what turned "
                    "the joints; export it with rotation channels"
                )
            raise UserError(f"{self.path}: the limbs have no rotation channels: nothing in it says how they move")
        degrees = np.degrees(bvh.largest) if self.config.angles == "radians" else bvh.largest
        if degrees > _WIDEST:
            raise UserError(f"{self.path}: MOTION turns a joint by {degrees:.3g} degrees: these are no angles")
        notes = []
        if self.config.angles == "degrees" and 0.5 < bvh.largest < FULL_TURN + 1e-3 and len(bvh.root) > 1:
            notes.append(
                f"no angle is larger than {bvh.largest:.2f}: if these are radians, not degrees, `angles=radians` "
                "reads them"
            )
        if not bvh.placed:
            notes.append("no joint has position channels: the person stays in place")
        loose = next(
            (f"{s}_{b}" for s in ("left", "right") for a, b in _HANGS if not _hangs(bvh, mapping, s, a, b)), ""
        )
        if loose:
            notes.append(
                f"joint '{bvh.names[mapping[loose]]}', taken for {loose}, does not hang from the limb's joint above: "
                "if the limbs move wrongly, say the joints with `mapping=FILE`"
            )
        return notes

    def _mapping(self, bvh: Bvh) -> dict[str, int]:
        mapping = match_rig(bvh.names, bvh.parents)
        if not self.config.mapping:
            return mapping
        given = read_mapping(self.config.mapping, bvh.names)
        mapping = {joint: j for joint, j in (mapping | given).items() if j >= 0}
        return mapping if given.get("pelvis", -1) >= 0 else mapping | {"pelvis": pelvis_of(mapping, bvh.parents)}


_HANGS = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"))


def _hangs(bvh: Bvh, mapping: dict[str, int], side: str, above: str, below: str) -> bool:
    return mapping[f"{side}_{above}"] in bvh.line(mapping[f"{side}_{below}"])
