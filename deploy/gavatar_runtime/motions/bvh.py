"""Motion capture in BVH files, retargeted by the names of their joints."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..errors import UserError
from ..formats.bvh_file import read_bvh
from ..values.motion import Motion
from .retarget import retarget
from .rig_names import match_rig, read_mapping
from .source import MOTIONS

UNITS = {"auto": 0.0, "m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "ft": 0.3048}
RESTS = ("offsets", "first-frame")
AXES = ("auto", "x", "y", "z", "-x", "-y", "-z")


@dataclasses.dataclass
class BvhOptions:
    """up: the file's vertical axis; auto takes the one that the trunk points along on average. units: auto, m, cm, mm,
    inch or ft; auto scales the walk by the legs of the body that plays it. mapping: a JSON file {SMPL joint: joint of
    the rig} for rigs whose names are not known. fps: overrides the file's, 0 keeps it. rest: the person
    stands at rest in the pose that the `offsets` draw, or in the `first-frame`, for files whose OFFSETs draw none."""

    up: str = "auto"
    rest: str = "offsets"
    units: str = "auto"
    mapping: str = ""
    fps: float = 0.0


@MOTIONS.register("bvh", config=BvhOptions, summary="BVH, retargeted by joint names (CMU, Mixamo and other rigs)")
class BvhFile:
    """A file of one person, 52 SMPL-H joints when read."""

    suffixes = (".bvh",)

    def __init__(self, config: BvhOptions, *, path: Path):
        if config.up not in AXES:
            raise UserError(f"motion option up={config.up}: choose from {', '.join(AXES)}")
        if config.rest not in RESTS:
            raise UserError(f"motion option rest={config.rest}: choose from {', '.join(RESTS)}")
        if config.units not in UNITS:
            raise UserError(f"motion option units={config.units}: choose from {', '.join(UNITS)}")
        if not isinstance(config.fps, (int, float)) or not 0 <= config.fps < 1e6:
            raise UserError(f"motion option fps={config.fps}: give a number of frames per second, 0 for the file's own")
        self.config, self.path = config, path

    def load(self) -> Motion:
        """The motion, y-up; UserError naming the file and what is wrong."""
        bvh = read_bvh(self.path)
        if self.config.rest == "first-frame":
            bvh = bvh.rested()
        mapping = match_rig(bvh.names, bvh.parents)
        if self.config.mapping:
            mapping |= read_mapping(self.config.mapping, bvh.names)
            mapping = {joint: j for joint, j in mapping.items() if j >= 0}
        scale = UNITS[self.config.units]
        motion = retarget(bvh, mapping, up=self.config.up, scale=scale, name=self.path.stem, source=str(self.path))
        motion = dataclasses.replace(motion, fps=float(self.config.fps) or motion.fps)
        return motion if scale == 0 else dataclasses.replace(motion, leg_length=None)
