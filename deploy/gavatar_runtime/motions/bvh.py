"""Motion capture in BVH files, retargeted by the names of their joints."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..errors import WrongValue
from ..formats.bvh_file import Bvh, read_bvh
from ..rigs.rest_pose import RESTS, with_rest_pose
from ..rigs.retarget import missing_limbs, retarget
from ..rigs.rig_names import match_rig, pelvis_of, read_mapping
from ..values.motion import Motion
from .plausible import UNITS, asked_rate, stated_rate
from .source import MOTIONS, MotionSource

AXES = ("auto", "x", "y", "z", "-x", "-y", "-z")


@dataclasses.dataclass
class BvhOptions:
    """up: the file's vertical axis; auto takes the one that the trunk points along on average. units: auto, m, cm, mm,
    inch or ft; auto scales the walk by the legs of the body that plays it. mapping: a JSON file {SMPL joint: joint of
    the rig} for rigs whose names are not known. fps: overrides the file's, 0 keeps it. rest: the person stands at rest
    in the pose that the `offsets` draw, in the `first-frame`, or in a T-pose that `anatomy` tells; `auto` chooses."""

    up: str = "auto"
    rest: str = "auto"
    units: str = "auto"
    mapping: str = ""
    fps: float = 0.0


@MOTIONS.register("bvh", config=BvhOptions, summary="BVH, retargeted by joint names (CMU, Mixamo and other rigs)")
class BvhFile(MotionSource):
    """A file of one person, 52 SMPL-H joints when read. facts: which rest pose was taken and why, once it is read."""

    suffixes = (".bvh",)

    def __init__(self, config: BvhOptions, *, path: Path):
        for name, known in (("up", AXES), ("rest", RESTS), ("units", UNITS)):
            if getattr(config, name) not in known:
                raise WrongValue(f"`{name}={getattr(config, name)}`: choose from {', '.join(known)}")
        self.config, self.path = config, path
        self.rate = asked_rate(config.fps)
        self.facts: dict[str, str] = {}

    def load(self) -> Motion:
        """The motion, y-up; UserError naming the file and what is wrong."""
        bvh = read_bvh(self.path)
        rate = self.rate or stated_rate(self.path, "Frame Time", bvh.fps, len(bvh.root))
        mapping = self._mapping(bvh)
        missing_limbs(bvh, mapping, str(self.path))
        bvh, rest, why = with_rest_pose(bvh, mapping, self.config.rest, self.config.up, str(self.path))
        self.facts = {"rest pose": f"{rest}: {why}"}
        scale = UNITS[self.config.units]
        motion = retarget(bvh, mapping, up=self.config.up, scale=scale, name=self.path.stem, source=str(self.path))
        notes = bvh.notes
        if self.config.rest == "auto" and rest != "offsets":
            notes += (f"rest pose {rest}: {why}; `rest` says another",)
        kept = {} if scale == 0 else {"leg_length": None}
        return dataclasses.replace(motion, fps=rate, notes=notes, **kept)

    def _mapping(self, bvh: Bvh) -> dict[str, int]:
        mapping = match_rig(bvh.names, bvh.parents)
        if not self.config.mapping:
            return mapping
        given = read_mapping(self.config.mapping, bvh.names)
        mapping = {joint: j for joint, j in (mapping | given).items() if j >= 0}
        return mapping if given.get("pelvis", -1) >= 0 else mapping | {"pelvis": pelvis_of(mapping, bvh.parents)}
