"""Motions by the names of their fields, in whatever container: .npz, .npy, pickles, joblib, PyTorch, JSON, folders of
one file a frame. Nothing in them is executed."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError, WrongValue
from ..formats.data_file import load_data
from ..values.motion import Motion
from .estimators import people_in
from .estimators.found import STAYS, natural
from .field_names import TRANS_KEYS
from .field_reader import as_array
from .fields import SmplFields
from .persons import choose_person, without_gaps
from .plausible import UNITS, asked_rate
from .rotation_kinds import KINDS
from .source import MOTIONS, MotionSource
from .upright import check_up


@dataclasses.dataclass
class FieldOptions:
    """up: the file's vertical axis, `y`, `z`, `-y` or `auto`: the one that the pelvis points along on average; AMASS's
    own files are z-up, gavatar's are y-up, a camera's are y-down, and none says so. fps: overrides the file's, 0 keeps
    it. person: the label of one of several; else the one with most frames. units: of trans, m, cm, mm, inch, ft or
    `auto`. rotations: how they are written, `auto` or one of `rotation_kinds`. hands: `full` rotations or `pca`
    coefficients; hand_mean: about the `flat` or the `mean` hand; `auto` as `HandFields` tells them."""

    up: str = "auto"
    fps: float = 0.0
    person: str = ""
    units: str = "auto"
    rotations: str = "auto"
    hands: str = "auto"
    hand_mean: str = "auto"


class FieldFile(MotionSource):
    """A file of one of the containers. facts: the tool that wrote it and the person taken, once it is read."""

    def __init__(self, config: FieldOptions, *, path: Path):
        check_up(config.up)
        asked_rate(config.fps)
        for name, known in (("units", UNITS), ("rotations", KINDS)):
            if getattr(config, name) not in known:
                raise WrongValue(f"`{name}={getattr(config, name)}`: choose from {', '.join(known)}")
        self.config, self.path = config, path
        self.facts: dict[str, str] = {}

    def content(self) -> Any:
        return load_data(self.path)

    def load(self) -> Motion:
        """The motion, y-up, float32. UserError naming the file and the field for anything missing, misshaped, not
        finite or not to be meant."""
        config = self.config
        found = people_in(self.content(), self.path, config.rotations)
        person, notes = choose_person(self.path, found.people, str(config.person))
        self.facts = {"written by": found.tool} if found.tool else {}
        self.facts |= {"person": person.label} if person.label else {}
        fields = SmplFields(
            self.path, person.fields, hands=config.hands, hand_mean=config.hand_mean, rotations=config.rotations
        )
        scale = _scaling(self.path, person.fields)
        motion = fields.motion(
            up=config.up, fps=config.fps, default_fps=found.fps, trans_scale=scale, units=config.units
        )
        placed = any(key in person.fields for key in TRANS_KEYS)
        notes += [note for note in found.notes if not (note == STAYS and placed)]
        motion = dataclasses.replace(motion, notes=(*notes, *motion.notes))
        return without_gaps(self.path, motion, person.frames)


def _scaling(path: Path, fields: dict[str, Any]) -> float:
    """Metres of the unit of AIST++'s smpl_trans: smpl_scaling is a body's metre in it (aist_plusplus/loader.py)."""
    if "smpl_scaling" not in fields:
        return 1.0
    stated = as_array(fields["smpl_scaling"])
    if stated is None or stated.size != 1 or stated.dtype.kind not in "fiu":
        raise UserError(f"{path}: smpl_scaling must be one positive number")
    scaling = float(stated.reshape(-1)[0])
    if not 0 < scaling < np.inf:
        raise UserError(f"{path}: smpl_scaling must be one positive number")
    return 1 / scaling


@MOTIONS.register("amass", config=FieldOptions, summary="AMASS, SMPL/SMPL-H/SMPL-X and pose estimators' .npz")
class NpzFile(FieldFile):
    suffixes = (".npz",)


@MOTIONS.register("npy", config=FieldOptions, summary=".npy: Motion-X, TRAM, or poses alone")
class NpyFile(FieldFile):
    suffixes = (".npy",)


@MOTIONS.register("aist", config=FieldOptions, summary=".pkl and .joblib: AIST++, WHAM, 4D-Humans, 3DPW and others")
class PickleFile(FieldFile):
    suffixes = (".pkl", ".pickle", ".joblib")


@MOTIONS.register("torch", config=FieldOptions, summary=".pth and .pt of tensors: GVHMR, GaussianAvatar, SMPL fields")
class TorchFile(FieldFile):
    suffixes = (".pth", ".pt")


@MOTIONS.register("json", config=FieldOptions, summary=".json: EasyMocap, or SMPL fields")
class JsonFile(FieldFile):
    suffixes = (".json",)


@MOTIONS.register("frames", config=FieldOptions, summary="a folder of one file a frame: EasyMocap, SMPLify-X")
class FrameFolder(FieldFile):
    """Files of one suffix, in the order of the numbers in their names; a sub-folder of a frame holds a file a person
    (SMPLify-X)."""

    folder = True

    def content(self) -> dict[str, Any]:
        suffixes = {s for kind in (JsonFile, PickleFile, NpzFile, NpyFile) for s in kind.suffixes}
        files = [f for f in self.path.rglob("*") if f.suffix.lower() in suffixes and not f.name.startswith(".")]
        files = [f for f in files if len(f.relative_to(self.path).parts) <= 2]
        kinds = {f.suffix.lower() for f in files}
        if len(kinds) != 1:
            what = f"files of several kinds ({', '.join(sorted(kinds))})" if kinds else "no file of poses"
            raise UserError(f"motion folder {self.path} holds {what}: it must hold one file a frame")
        frames: dict[str, Any] = {}
        for file in sorted(files, key=lambda f: natural(f.relative_to(self.path).as_posix())):
            content = load_data(file)
            inner = file.parent != self.path
            name = file.parent.name if inner else file.stem
            if inner and isinstance(content, dict):
                frames.setdefault(name, []).append({"id": file.stem, **content})
            else:
                frames[name] = content
        return frames
