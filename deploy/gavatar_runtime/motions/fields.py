"""From the named arrays of a file to a motion: the field names of the SMPL family's many writers, and their axes."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Faults, UserError, frames_named
from ..motion import Motion
from ..rotations import axis_angle_from_matrix, matrix_from_axis_angle

FRAME_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps", "frame_rate")
WHOLE_KEYS = ("poses", "fullpose", "thetas", "smpl_poses", "pose")
ROOT_KEYS = ("root_orient", "global_orient")
BODY_KEYS = ("pose_body", "body_pose")
JAW_KEYS = ("pose_jaw", "jaw_pose")
EYE_KEYS = ("pose_eye", ("leye_pose", "reye_pose"))
HAND_KEYS = ("pose_hand", ("left_hand_pose", "right_hand_pose"))
TRANS_KEYS = ("trans", "transl", "smpl_trans")
BETAS_KEYS = ("betas", "beta", "shapes")


def _flat(keys: tuple) -> tuple[str, ...]:
    return tuple(k for key in keys for k in (key if isinstance(key, tuple) else (key,)))


KEYS = (
    *WHOLE_KEYS, *ROOT_KEYS, *BODY_KEYS, *JAW_KEYS, *_flat(EYE_KEYS), *_flat(HAND_KEYS), *TRANS_KEYS, *BETAS_KEYS,
    *FRAME_RATE_KEYS, "leg_length",
)  # fmt: skip

# rows: the axes of a y-up world in the file's world
Y_UP_FROM = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-y": np.diag([1.0, -1, -1]),  # a camera's own axes: y down, z forward
}


class SmplFields:
    """The arrays of one file, by name, read as a motion; in place of an array, the UserError that reading it gave.

    path: named in every message. Fields, of T frames in radians and metres, the first of each list that is there:
    poses (or fullpose, thetas, smpl_poses, pose) (T, 3J) or (T, J, 3) axis-angle; or root_orient and pose_body with
    pose_hand, pose_jaw, pose_eye (AMASS), or global_orient and body_pose with jaw_pose, leye_pose, ..., (smplx; a
    body_pose of 72 or 165 numbers without global_orient is a whole pose, as in upstream's files); trans (or transl),
    zero if absent; betas (or beta); mocap_framerate (or mocap_frame_rate, fps); leg_length,
    optional, as `Motion` has it.
    """

    def __init__(self, path: Path, arrays: Mapping[str, Any]):
        self.path, self.arrays = path, arrays

    def motion(self, *, up: str, fps: float, default_fps: float = 0.0, trans_scale: float = 1.0) -> Motion:
        """The motion, y-up, float32.

        up: as in `y_up`. fps: overrides the file's rate, 0 keeps it. default_fps: of a format that states none.
        Raises UserError naming the file and the field for anything missing, misshaped or not finite; its `sentences`
        are one for every field at fault.
        """
        faults = Faults(collect=True)
        poses = faults.of(self._poses)
        trans = faults.of(self._trans, self._rows() if poses is None else len(poses))
        rate = faults.of(self._fps, fps, default_fps)
        betas, leg_length = faults.of(self._betas), faults.of(self._leg_length)
        faults.stop()
        motion = Motion(poses, trans * np.float32(trans_scale), rate, betas, self.path.stem, leg_length)
        return y_up(motion, up)

    def _rows(self) -> int | None:
        """Frames of poses that could not be read, None where that cannot be told."""
        key = self._key((*WHOLE_KEYS, *BODY_KEYS))
        shape = () if key is None else np.shape(self.arrays[key])
        return shape[0] if len(shape) > 1 else None

    def _poses(self) -> np.ndarray:
        key = self._key(WHOLE_KEYS)
        if key is None and self._key(ROOT_KEYS) is None:
            body = self._key(BODY_KEYS)
            key = body if body is not None and np.shape(self.arrays[body])[-1:] in ((72,), (156,), (165,)) else None
        if key is None:
            if self._key(BODY_KEYS) is None or self._key(ROOT_KEYS) is None:
                raise UserError(
                    f"{self.path}: key 'poses' is missing; a motion holds poses (T, 3J), trans (T, 3) and "
                    f"mocap_framerate, or root_orient and pose_body; this file holds "
                    f"{', '.join(sorted(self.arrays)) or 'nothing'}"
                )
            return self._assembled()
        poses = self._numbers(key)
        if poses.ndim == 3 and poses.shape[2] == 3:
            poses = poses.reshape(len(poses), -1)
        if poses.ndim != 2 or poses.shape[1] % 3 or poses.shape[1] == 0:
            raise UserError(
                f"{self.path}: {key} has shape {poses.shape}, expected (T, 3J), three axis-angle numbers a joint"
            )
        if len(poses) == 0:
            raise UserError(f"{self.path}: {key} holds no frame")
        return self._finite(key, poses).reshape(len(poses), -1, 3)

    def _assembled(self) -> np.ndarray:
        """(T, J, 3) from fields of body parts: 24 joints (a body_pose of 23), 22, 52 with hands, 55 with a face."""
        faults, root, body = Faults(collect=True), self._key(ROOT_KEYS), self._key(BODY_KEYS)
        parts = {root: faults.of(self._part, root, 3), body: faults.of(self._part, body, None)}
        width = 0 if parts[body] is None else parts[body].shape[1]
        if parts[body] is not None and width not in (63, 69):
            faults.add(f"{self.path}: {body} holds {width} numbers a frame, expected 63 (21 joints) or 69 (23)")
        others = {
            keys: faults.of(self._optional, keys, w) for keys, w in ((JAW_KEYS, 3), (EYE_KEYS, 6), (HAND_KEYS, 90))
        }
        if width == 63 and (others[JAW_KEYS] is not None or others[EYE_KEYS] is not None):
            others = {
                keys: np.zeros((1, w), np.float32) if others[keys] is None else others[keys]
                for keys, w in ((JAW_KEYS, 3), (EYE_KEYS, 6), (HAND_KEYS, 90))
            }
        if width == 63:
            parts |= {" and ".join(_flat(keys[:1])): part for keys, part in others.items() if part is not None}
        lengths = {name: len(part) for name, part in parts.items() if part is not None}
        frames = max(lengths.values(), default=0)
        for name, length in lengths.items():
            if length == 0:
                faults.add(f"{self.path}: {name} holds no frame")
            elif length not in (1, frames):
                longest = max(lengths, key=lengths.get)
                faults.add(f"{self.path}: {name} has {length} frames and {longest} {frames}: they must agree")
        faults.stop()
        poses = np.concatenate([np.broadcast_to(part, (frames, part.shape[1])) for part in parts.values()], 1)
        return poses.reshape(frames, -1, 3)

    def _optional(self, keys: tuple, width: int) -> np.ndarray | None:
        """A part of exactly `width` numbers a frame, or None; a pair of keys stands for its two halves."""
        for key in keys:
            names = key if isinstance(key, tuple) else (key,)
            if all(name in self.arrays for name in names):
                faults = Faults(collect=True)
                halves = [faults.of(self._part, name, None) for name in names]
                faults.stop()
                if sum(half.shape[1] for half in halves) == width and len({len(h) for h in halves}) == 1:
                    return np.concatenate(halves, 1)
                warnings.warn(
                    f"{self.path}: {' and '.join(names)} hold {halves[0].shape[1]} numbers a frame, not "
                    f"{width // len(names)} (coefficients of a hand model?): these joints keep their rest pose",
                    stacklevel=2,
                )
        return None

    def _part(self, key: str, width: int | None) -> np.ndarray:
        array = self._numbers(key)
        array = array.reshape(1, -1) if array.ndim == 1 else array.reshape(len(array), int(np.prod(array.shape[1:])))
        if width is not None and array.shape[1] != width:
            raise UserError(f"{self.path}: {key} holds {array.shape[1]} numbers a frame, expected {width}")
        return self._finite(key, array)

    def _trans(self, frames: int | None) -> np.ndarray:
        """(T, 3); frames: None where the poses could not be read."""
        key = self._key(TRANS_KEYS)
        if key is None:
            return np.zeros((frames or 0, 3), np.float32)
        trans = self._numbers(key)
        if frames is None and trans.ndim == 2:
            frames = len(trans)
        if trans.shape != (frames, 3):
            raise UserError(f"{self.path}: {key} has shape {trans.shape}, expected ({frames}, 3) to match poses")
        return self._finite(key, trans)

    def _fps(self, asked: float, default: float) -> float:
        if not isinstance(asked, (int, float)):
            raise UserError(f"motion option fps={asked}: give a number of frames per second, 0 for the file's own")
        key = self._key(FRAME_RATE_KEYS)
        if asked:
            fps, key = float(asked), "the option fps"
        elif key is None and default:
            fps = default
        elif key is None:
            raise UserError(f"{self.path}: key 'mocap_framerate' is missing; add it or give the option fps")
        else:
            value = self._numbers(key)
            fps = float(value.reshape(-1)[0]) if value.size == 1 else np.nan
        if not (np.isfinite(fps) and fps > 0):
            raise UserError(f"{self.path}: {key} must be one positive number of frames per second")
        return fps

    def _betas(self) -> np.ndarray | None:
        key = self._key(BETAS_KEYS)
        if key is None:
            return None
        betas = self._numbers(key)
        betas = betas.reshape(len(betas), -1)[:1] if betas.ndim == 2 else betas  # one shape a frame: the first
        return self._finite("betas", betas.reshape(1, -1))[0]

    def _leg_length(self) -> float | None:
        if "leg_length" not in self.arrays:
            return None
        value = self._numbers("leg_length")
        if value.size != 1 or not 0 < float(value.reshape(-1)[0]) < np.inf:
            raise UserError(f"{self.path}: leg_length must be one positive number of metres")
        return float(value.reshape(-1)[0])

    def _key(self, keys: tuple[str, ...]) -> str | None:
        return next((key for key in keys if key in self.arrays), None)

    def _numbers(self, key: str) -> np.ndarray:
        if isinstance(self.arrays[key], UserError):  # what reading it gave
            raise self.arrays[key]
        array = np.asarray(self.arrays[key])
        if array.dtype.kind not in "fiu":
            raise UserError(f"{self.path}: {key} holds {array.dtype} values, expected numbers")
        return array

    def _finite(self, key: str, array: np.ndarray) -> np.ndarray:
        """(T, ...) as float32; what overflows there counts as infinite too."""
        with np.errstate(over="ignore"):
            array = np.asarray(array, np.float32)
        bad = ~np.isfinite(array).all(tuple(range(1, array.ndim)))
        if bad.any():
            where = "" if key == "betas" else f" at {frames_named(np.flatnonzero(bad))}"
            raise UserError(f"{self.path}: {key} holds NaN or infinite values{where}")
        return array


def check_up(up: str) -> None:
    """UserError unless `up` is auto or one of the axes of `Y_UP_FROM`."""
    if up not in ("auto", *Y_UP_FROM):
        raise UserError(f"motion option up={up}: choose from auto, {', '.join(Y_UP_FROM)}")


def vertical_axis(poses: np.ndarray) -> str:
    """The axis (`y`, `z` or `-y`) that the pelvis' own up axis points along on average over the frames."""
    up = matrix_from_axis_angle(poses[:, 0].astype(np.float64))[:, :, 1].mean(0)
    if up[2] > abs(up[1]):
        return "z"
    return "-y" if up[1] < -0.5 else "y"


def y_up(motion: Motion, up: str = "auto") -> Motion:
    """The same motion in a y-up world; up: the axis that is vertical now, `auto` finds it.

    The pelvis' rest offset is left out of the turn: it depends on the body and shifts every frame alike.
    """
    up = vertical_axis(motion.poses) if up == "auto" else up
    if up == "y":
        return motion
    turn = Y_UP_FROM[up]
    poses = motion.poses.copy()
    poses[:, 0] = axis_angle_from_matrix(turn @ matrix_from_axis_angle(poses[:, 0].astype(np.float64)))
    return dataclasses.replace(motion, poses=poses, trans=(motion.trans @ turn.T).astype(np.float32))
