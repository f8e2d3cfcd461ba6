"""How each tool names the fields of one person: a table, and what takes a person out of a dictionary by it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from ...geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from ..field_names import BODY_KEYS, WHOLE_KEYS
from ..field_reader import as_array
from ..rotation_kinds import axis_angle
from ..upright import MEAN_PELVIS
from .found import CAMERA, STAYS, Found, Person, split_people
from .single_frames import with_frames

AIST_FPS = 60.0  # of the data set's videos; its files do not say
EDGE_FPS = 30.0  # of dances by EDGE (Tseng et al. 2023), which are told by their joint positions, full_pose (T, 24, 3)
MOTION_X_FPS = 30.0  # "all motions have been unified in 30 fps", its README


@dataclasses.dataclass(frozen=True)
class Layout:
    """marks: names that a dictionary must have to be of this tool. fields: the name of ours by theirs, what is not
    named keeps its name; a dotted name lies one dictionary down. change: makes our fields of those. frames: what
    holds the numbers of the video's frames. fps, notes: as `Found` has them."""

    tool: str
    marks: tuple[str, ...]
    fields: dict[str, str] = dataclasses.field(default_factory=dict)
    change: Callable[[dict[str, Any]], dict[str, Any]] | None = None
    frames: str = "frame_ids"
    fps: float = 0.0
    notes: tuple[str, ...] = ()


def _easymocap(fields: dict[str, Any]) -> dict[str, Any]:
    """EasyMocap turns the body by Rh about the model's origin, then adds Th; poses may lack the root's rotation. Of 87
    numbers (SMPL-X) 12 after the body are coefficients of the hands, then come jaw and eyes."""
    Rh, Th, poses = (as_array(fields.get(key)) for key in ("Rh", "Th", "poses"))
    if poses is None or Rh is None or poses.ndim != 2 or Rh.shape != (len(poses), 3):
        return fields
    if poses.shape[1] in (63, 69):
        poses = np.concatenate([np.zeros((len(poses), 3)), poses], 1)
    turn = matrix_from_axis_angle(Rh.astype(np.float64))
    root = turn @ matrix_from_axis_angle(poses[:, :3].astype(np.float64))
    pelvis = np.array(MEAN_PELVIS["smplx" if poses.shape[1] in (87, 165) else "smpl"])
    poses = np.concatenate([axis_angle_from_matrix(root), poses[:, 3:]], 1)
    out = {key: value for key, value in fields.items() if key not in ("Rh", "Th", "poses")}
    if Th is not None and Th.shape == Rh.shape:
        out["trans"] = Th + turn @ pelvis - pelvis
    if poses.shape[1] == 87:
        names = {"global_orient": 3, "body_pose": 63, "left_hand_pose": 6, "right_hand_pose": 6, "jaw_pose": 3,
                 "leye_pose": 3, "reye_pose": 3}  # fmt: skip
        parts = np.split(poses, np.cumsum(list(names.values()))[:-1], 1)
        return out | dict(zip(names, parts, strict=True))
    return out | {"poses": poses}


def _mdm(fields: dict[str, Any]) -> dict[str, Any]:
    """Motion Diffusion Model, `..._smpl_params.npy`: thetas (24, 6, T), the first two rows of matrices; root (3, T)."""
    thetas, root = as_array(fields["thetas"]), as_array(fields["root_translation"])
    if thetas is None or thetas.ndim != 3 or thetas.shape[1] != 6 or root is None or root.ndim != 2:
        return fields
    poses, _ = axis_angle("thetas", np.moveaxis(thetas, -1, 0), "6d-rows")
    return {"poses": poses, "trans": root.T}


def _pymaf_x(fields: dict[str, Any]) -> dict[str, Any]:
    """smplx_params: a dictionary, or one a batch, of matrices; body_pose may begin with the pelvis."""
    batches = fields["smplx_params"]
    batches = list(batches) if isinstance(batches, (list, tuple, np.ndarray)) else [batches]
    if not all(isinstance(batch, dict) for batch in batches) or not batches:
        return fields
    arrays = {key: [as_array(batch.get(key)) for batch in batches] for key in batches[0]}
    whole = {k: [a for a in v if a is not None and a.ndim] for k, v in arrays.items()}
    out: dict[str, Any] = {k: np.concatenate(v) for k, v in whole.items() if len(v) == len(batches)}
    body = out.get("body_pose")
    if body is not None and "global_orient" not in out and body.ndim > 2 and body.shape[1] == 22:
        out |= {"global_orient": body[:, :1], "body_pose": body[:, 1:]}
    if "shape" in out:
        out["betas"] = out.pop("shape")
    return out | {key: fields[key] for key in ("frame_ids",) if key in fields}


# The first whose marks a dictionary has is its tool
LAYOUTS = (
    Layout("GVHMR", ("smpl_params_global",), {"smpl_params_global.*": ""}),
    Layout("GVHMR", ("smpl_params_incam",), {"smpl_params_incam.*": ""}, notes=(CAMERA,)),
    Layout("PyMAF-X", ("smplx_params",), change=_pymaf_x, notes=(STAYS,)),
    Layout("WHAM", ("pose_world", "trans_world"), {"pose_world": "poses", "trans_world": "trans", "pose": ""}),
    Layout("TRAM", ("pred_rotmat", "pred_trans"), frames="frame", notes=(CAMERA,)),
    Layout("VIBE or PyMAF", ("pose", "pred_cam"), notes=(STAYS,)),
    Layout("ROMP", ("smpl_thetas",), frames="frame_id", notes=(CAMERA,)),
    Layout("EasyMocap", ("poses", "Rh"), change=_easymocap),
    Layout("Motion Diffusion Model", ("thetas", "root_translation"), change=_mdm, fps=20.0),
    Layout("3DPW", ("poses", "cam_poses"), fps=30.0),
    Layout("AIST++", ("smpl_poses", "smpl_scaling"), fps=AIST_FPS),
    Layout("EDGE", ("smpl_poses", "full_pose"), fps=EDGE_FPS),
    Layout("AIST++", ("smpl_poses", "smpl_trans"), fps=AIST_FPS),
    Layout("SLAHMR", ("root_orient", "pose_body", "track_mask")),
    Layout("SMPLify-X", ("camera_rotation", "global_orient", "body_pose"), notes=(STAYS,)),
    *(Layout("", (key,)) for key in WHOLE_KEYS),
    *(Layout("", (body,)) for body in BODY_KEYS),
)


def layout_of(content: Any) -> Layout | None:
    """The layout of a dictionary of one file or of one person, if it is any."""
    if not isinstance(content, dict):
        return None
    return next((layout for layout in LAYOUTS if set(layout.marks) <= set(content)), None)


def people_by(layout: Layout, content: dict[str, Any], label: str = "") -> Found:
    """The persons of a dictionary of that layout; `label` is the person's where there is one."""
    fields = _renamed(layout, content)
    people = []
    split = split_people(fields)
    for number, mine in enumerate(split):
        mine = with_frames(layout.change(mine) if layout.change else mine)
        frames, mask = as_array(mine.pop(layout.frames, None)), as_array(mine.pop("track_mask", None))
        person = Person(str(number) if len(split) > 1 else label, mine, frames)
        people.append(_seen(person, mask))
    return Found(layout.tool, people, layout.fps, layout.notes)


def _renamed(layout: Layout, content: dict[str, Any]) -> dict[str, Any]:
    fields = dict(content)
    for theirs, ours in layout.fields.items():
        if theirs.endswith(".*"):
            inner = fields.pop(theirs[:-2])
            fields = dict(inner) if isinstance(inner, dict) else fields
        elif theirs in fields:
            value = fields.pop(theirs)
            if ours:
                fields[ours] = value
    return fields


def _seen(person: Person, mask: np.ndarray | None) -> Person:
    """The person from the first to the last frame in which a mask (T,) says that it was seen."""
    if mask is None or mask.dtype.kind not in "biuf" or mask.shape != (len(person),) or not (mask > 0).any():
        return person
    seen = np.flatnonzero(mask > 0)
    part, count = slice(seen[0], seen[-1] + 1), len(person)
    fields = {key: _cut(value, part, count) for key, value in person.fields.items()}
    return Person(person.label, fields, person.frames)


def _cut(value: Any, part: slice, count: int) -> Any:
    array = as_array(value)
    return array[part] if array is not None and array.ndim > 1 and len(array) == count else value
