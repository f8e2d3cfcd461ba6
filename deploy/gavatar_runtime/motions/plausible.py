"""Numbers that cannot be meant: frame rates, distances and angles that no recording of a person has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError, WrongValue
from ..values.skeletons import SKELETONS

UNITS = {"auto": 0.0, "m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "ft": 0.3048}
ASSUMED_FPS = 30.0
SLOWEST, FASTEST = 1.0, 500.0  # frames per second that a file may state
FAR, HIGH, FAST = 100.0, 20.0, 20.0  # metres from the start, metres of height, metres a second: beyond, it is doubted
FARTHEST = 1e5  # metres: beyond, nothing is played
FULL_TURN = 2 * np.pi
_BEYOND_HALF = 0.01  # of the joints of all frames may be turned by more than half a turn, as fits leave it


def asked_rate(fps: Any) -> float:
    """Frames per second of the option fps, 0 for the file's own. UserError for what is no rate."""
    if isinstance(fps, bool) or not isinstance(fps, (int, float)) or not 0 <= fps < 1e6:
        raise WrongValue(f"`fps={fps}`: give a number of frames per second, 0 for the file's own")
    return float(fps)


def stated_rate(path: Path, name: str, fps: float, frames: int) -> float:
    """The rate that a file states by its field `name`, if a camera may have had it.

    UserError names the field and how another rate is given. Of one frame no rate matters.
    """
    if frames == 1:
        return float(fps) if np.isfinite(fps) and 0 < fps < 1e6 else ASSUMED_FPS
    way_out = "say the rate with `fps=30` (or what it is)"
    if not (np.isfinite(fps) and fps > 0):
        what = "positive number of seconds" if name == "Frame Time" else "one positive number of frames per second"
        raise UserError(f"{path}: {name} must be {'a ' if name == 'Frame Time' else ''}{what}; {way_out}")
    if fps > FASTEST:
        count = ", as many as it has frames," if round(fps) == frames else ""
        raise UserError(f"{path}: {name} says {fps:g} frames a second{count} which no recording has; {way_out}")
    if fps < SLOWEST:
        hint = f": is it the seconds of a frame, `fps={1 / fps:.4g}`?" if fps > 1e-3 else ""
        raise UserError(f"{path}: {name} says {fps:g} frames a second, less than one{hint or '; ' + way_out}")
    return float(fps)


def in_metres(path: Path, trans: np.ndarray, fps: float, units: str) -> tuple[np.ndarray, list[str]]:
    """(T, 3) a y-up translation in metres, and notes. units: of `UNITS`; `auto` takes metres, unless they would lift
    the person above any house or carry it away, and centimetres or millimetres would not.

    UserError for what is no way of a person in any of them.
    """
    if units != "auto":
        return trans * np.float32(UNITS[units]), []
    height, span = _height_and_span(trans)
    if height > HIGH or span > FAR:
        for unit in ("cm", "mm"):
            if max(height / 4, span / FAR) * UNITS[unit] <= 1 and (height > HIGH or _speed(trans, fps) > FAST):
                what = f"trans is {height:.0f} high" if height > HIGH else f"trans goes {span:.0f} far"
                return trans * np.float32(UNITS[unit]), [
                    f"{what}: it is taken for {unit}, not metres; `units=m` says otherwise"
                ]
    if max(height, span) > FARTHEST:
        raise UserError(
            f"{path}: trans is up to {max(height, span):.3g} m away, where nobody is; `units=cm` or mm says what it is "
            "in"
        )
    return trans, [f"{note}: if it is not in metres, `units=cm` or mm says so" for note in check_way(trans, fps)]


def check_way(trans: np.ndarray, fps: float, height: bool = True) -> list[str]:
    """Notes on a y-up translation (T, 3) in metres that goes farther or faster than people do."""
    high, span = _height_and_span(trans)
    high = high if height else 0.0
    if high <= HIGH and span <= FAR and _speed(trans, fps) <= FAST:
        return []
    return [f"trans goes {span:.0f} m far, {high:.0f} m high, at {_speed(trans, fps):.0f} m a second"]


def _height_and_span(trans: np.ndarray) -> tuple[float, float]:
    span = np.abs(trans.astype(np.float64) - trans[0]).max(initial=0.0) if len(trans) else 0.0
    return float(np.abs(np.median(trans[:, 1].astype(np.float64)))) if len(trans) else 0.0, float(span)


def _speed(trans: np.ndarray, fps: float) -> float:
    """Metres a second of the median step."""
    steps = np.linalg.norm(np.diff(trans.astype(np.float64), axis=0), axis=-1)
    return float(np.median(steps) * fps) if len(steps) else 0.0


_MOST_JOINTS = 500
# Numbers a frame that are not axis-angle of any skeleton, and what they are then
_KNOWN_JOINTS = (21, 22, 23, 24, 51, 52, 54, 55)
_WIDTHS = {
    **{4 * n: f"{n} quaternions, though not of length one" for n in _KNOWN_JOINTS},
    **{6 * n: f"{n} joints in 6D (two columns of a rotation matrix): `rotations=6d` or 6d-rows reads them"
       for n in _KNOWN_JOINTS},
    **{9 * n: f"{n} matrices, though of no rotations" for n in _KNOWN_JOINTS},
    63: "21 joints: a body without its pelvis, whose rotation must stand in global_orient",
    69: "23 joints: a body without its pelvis, whose rotation must stand in global_orient",
    135: "3 numbers and 22 joints in 6D, it seems: store them apart, as trans and poses_6d",
    147: "3 numbers and 24 joints in 6D, it seems: store them apart, as trans and poses_6d",
    315: "3 numbers of a place and 52 joints in 6D, as FineDance and LODGE have them: store them apart, as trans and "
         "poses_6d",
    168: "55 joints and 3 numbers of a place, as Inter-X and ReGenNet have them: store them apart, as poses and trans",
    46: "the 46 angles of SKEL, as HSMR writes them, not SMPL's rotations: take SMPL's poses, which SKEL's code makes "
        "of them",
    272: "the features of the 272-dim motion representation: its recover_visualize.py makes SMPL's poses of them",
    263: "the features that HumanML3D trains on, not rotations",
    251: "the features that KIT-ML trains on, not rotations",
}  # fmt: skip


def check_layout(path: Path, key: str, array: np.ndarray) -> None:
    """UserError where the frames of poses are plainly the last axis."""
    joints = {len(names) for names in SKELETONS.values()}
    rows = array.shape[0] if array.ndim > 1 else 0
    last = array.ndim == 2 and rows % 3 == 0 and rows // 3 in joints and 3 < array.shape[1] < 60
    last = last or (array.ndim == 3 and rows in joints and array.shape[1] in (3, 6) and array.shape[2] not in (2, 3))
    if last:
        axes = (1, 0) if array.ndim == 2 else (2, 0, 1)
        raise UserError(
            f"{path}: {key} has shape {array.shape}: its frames seem to be the last axis; store "
            f"{key}.transpose{axes}, with the frames first"
        )


def check_joints(path: Path, key: str, width: int) -> list[str]:
    """Notes on axis-angle poses of `width` numbers a frame; UserError where they are plainly something else."""
    counts = sorted({len(names) for names in SKELETONS.values()})
    if width == 3:
        return [f"{key} turns one joint, the pelvis: no limb moves"]
    if width % 3 == 0 and width // 3 in counts:
        return []
    if width > 3 * _MOST_JOINTS:
        raise UserError(
            f"{path}: {key} holds {width} numbers a frame: no body has so many joints; vertices of a mesh say nothing "
            "of how joints turn"
        )
    if width in _WIDTHS:
        raise UserError(f"{path}: {key} holds {width} numbers a frame: {_WIDTHS[width]}")
    if width % 3:
        return []  # what reads them says so
    return [
        f"{key} has {width // 3} joints, which no body of the SMPL family has ({', '.join(map(str, counts))}): they "
        "are taken in the order of the avatar's joints"
    ]


def check_angles(path: Path, key: str, poses: np.ndarray) -> list[str]:
    """Notes on axis-angle poses (T, J, 3), radians; UserError where they are plainly degrees or nonsense."""
    angle = np.linalg.norm(poses.astype(np.float64), axis=-1)
    largest = angle.max(initial=0.0)
    if largest > 2 * FULL_TURN:
        if largest < 1000:
            raise UserError(
                f"{path}: {key} turns a joint by {largest:.0f} radians: if these are degrees, "
                "`rotations=degrees` reads them"
            )
        raise UserError(f"{path}: {key} turns a joint by {largest:.3g} radians: these are no rotations")
    what, inner = "", angle[:, 1:]
    if inner.max(initial=0.0) > FULL_TURN + 1e-3:
        what = "more than a full turn"
    elif inner.size and (inner > np.pi + 1e-2).mean() > _BEYOND_HALF:
        what = "many by more than half a turn"
    said = f"{key} turns a joint by {largest:.1f} radians, {what}: if these are degrees, `rotations=degrees` reads them"
    return [said] if what else []
