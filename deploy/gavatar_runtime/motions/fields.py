"""From the named arrays of one person to a motion: the field names of the SMPL family's many writers."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..errors import Faults, UserError
from ..values.motion import HandParameters, Motion
from .field_names import (
    BETAS_KEYS,
    BODY_KEYS,
    EXPRESSION_KEYS,
    EYE_KEYS,
    FRAME_RATE_KEYS,
    JAW_KEYS,
    ROOT_KEYS,
    TRANS_KEYS,
    WHOLE_KEYS,
    flat,
)
from .field_reader import as_array
from .hand_fields import HandFields, with_hands
from .plausible import ASSUMED_FPS, asked_rate, check_angles, check_joints, check_layout, in_metres, stated_rate
from .refusals import poses_missing, positions_refused
from .rotation_kinds import are_positions, told_kind
from .upright import y_up

# Numbers a frame of SMPL-H poses with 6 or 12 coefficients a hand, as MANO's own loader has them (66 + 2 K)
COMPACT = {78: 6, 90: 12}


class SmplFields(HandFields):
    """The arrays of one person, by name, read as a motion.

    path: named in every message. Fields, of T frames in radians and metres, the first of each list of `field_names`
    that is there: poses (or fullpose, thetas, smpl_poses, ...), a rotation a joint; or root_orient and pose_body with
    pose_hand, pose_jaw, pose_eye (AMASS), or global_orient and body_pose with jaw_pose, leye_pose, ..., (smplx; a
    body_pose of 72 or 165 numbers without global_orient is a whole pose, as in upstream's files); trans (or transl),
    zero if absent; betas (or beta); mocap_framerate (or mocap_frame_rate, fps); expression, (T, E), one row for all
    frames or none; leg_length, optional, as `Motion` has it. Rotations are axis-angle, matrices or quaternions
    (`rotation_kinds`). Hands: see `HandFields`.
    """

    def motion(
        self, *, up: str, fps: float, default_fps: float = 0.0, trans_scale: float = 1.0, units: str = "auto"
    ) -> Motion:
        """The motion, y-up, float32, with notes on what was assumed.

        up: as in `y_up`. fps: overrides the file's rate, 0 keeps it. default_fps: of a format that states none; without
        either, `ASSUMED_FPS` with a note. trans_scale: metres of the file's unit, where the format tells it. units: as
        in `in_metres`. Raises UserError naming the file and the field for anything missing, misshaped, not finite or
        not to be meant; its `sentences` are one for every field at fault.
        """
        faults = Faults(collect=True)
        posed: tuple[Any, HandParameters | None] = faults.of(self._posed) or (None, None)
        poses, hands = posed
        frames = self._rows() if poses is None else len(poses)
        trans = faults.of(self._trans, frames)
        rate = faults.of(self._fps, fps, default_fps, frames)
        betas, leg_length = faults.of(self._betas), faults.of(self._leg_length)
        expression = faults.of(self._expression, frames)
        faults.stop()
        trans = trans * np.float32(trans_scale)
        motion = y_up(Motion(poses, trans, rate, betas, self.path.stem, leg_length, expression, hands), up)
        trans, notes = in_metres(self.path, motion.trans, rate, units)
        return dataclasses.replace(motion, trans=trans, notes=(*self.notes, *notes))

    def _rows(self) -> int | None:
        """Frames of poses that could not be read, None where that cannot be told."""
        key = self.key((*WHOLE_KEYS, *BODY_KEYS))
        shape: tuple[int, ...] = () if key is None or isinstance(self.arrays[key], str) else np.shape(self.arrays[key])
        return shape[0] if len(shape) > 1 else None

    def _posed(self) -> tuple[np.ndarray, HandParameters | None]:
        """(T, J, 3) axis-angle of the joints, and the hands that need a model to become such."""
        key = self.key(WHOLE_KEYS)
        if key is None and self.key(ROOT_KEYS) is None:
            body = self.key(BODY_KEYS)
            key = body if body is not None and np.shape(self.arrays[body])[-1:] in ((72,), (156,), (165,)) else None
        if key is not None:
            return self._whole(key)
        root, body = self.key(ROOT_KEYS), self.key(BODY_KEYS)
        if root is None or body is None:
            raise poses_missing(self.path, self.arrays)
        return self._assembled(root, body)

    def _whole(self, key: str) -> tuple[np.ndarray, HandParameters | None]:
        """Of one array of all joints; hands from fields of their own take the place of fingers that never move."""
        poses, _ = self._rotations(key)
        width = poses.shape[1]
        if width in COMPACT or (width in (156, 165) and (self.hands == "pca" or self.hand_mean == "mean")):
            hands = self.understood(key, np.stack(np.split(poses[:, 66 if width in COMPACT else -90 :], 2, 1), 1))
            poses = poses[:, :66] if width in COMPACT else np.concatenate([poses[:, :-90], 0 * poses[:, -90:]], 1)
        elif width in (156, 165) and poses[:, -90:].any():
            hands = None
        else:
            hands = self.both_hands()
        poses = poses.reshape(len(poses), -1, 3)
        if hands is not None and len(hands.values) not in (1, len(poses)):
            raise UserError(
                f"{self.path}: its hand poses have {len(hands.values)} frames and {key} {len(poses)}: they must agree"
            )
        return with_hands(poses, hands)

    def _rotations(self, key: str) -> tuple[np.ndarray, str]:
        """(T, 3J) and their kind; UserError for joint positions and for what has no three numbers a joint."""
        array = self.numbers(key)
        if array.ndim > 1 and len(array) == 0:
            raise UserError(f"{self.path}: {key} holds no frame")
        if array.ndim < 2 or array.size == 0:
            raise UserError(
                f"{self.path}: {key} has shape {array.shape}, expected (T, 3J), three axis-angle numbers a joint"
            )
        width = array.size // len(array)
        if self.kind == "auto":
            check_layout(self.path, key, array)
        told = self.kind == "auto" and width not in COMPACT and array.ndim < 4
        if told and told_kind(f"{self.path}: {key}", array) == "axis-angle":
            self.notes += check_joints(self.path, key, width)
        poses, kind = self.turned(key)
        if kind == "axis-angle" and self.kind == "auto" and are_positions(poses.reshape(len(poses), -1, 3)):
            raise positions_refused(self.path, key, poses.shape[1] // 3)
        if kind in ("axis-angle", "degrees") and width not in COMPACT:
            self.notes += check_angles(self.path, key, poses.reshape(len(poses), -1, 3))
        return poses, kind

    def _assembled(self, root: str, body: str) -> tuple[np.ndarray, HandParameters | None]:
        """Of fields of body parts: 24 joints (a body_pose of 23), 22, 52 with hands, 55 with a face."""
        faults = Faults(collect=True)
        parts = {root: faults.of(self._turned, root, 3), body: faults.of(self._turned, body, None)}
        width = 0 if parts[body] is None else parts[body].shape[1]
        if parts[body] is not None and width not in (63, 69):
            faults.add(f"{self.path}: {body} holds {width} numbers a frame, expected 63 (21 joints) or 69 (23)")
        jaw, eyes = faults.of(self._face, JAW_KEYS, 3), faults.of(self._face, EYE_KEYS, 6)
        hands = faults.of(self.both_hands)
        if width == 63 and (jaw or eyes):
            parts |= jaw or {"jaw": np.zeros((1, 3), np.float32)}
            parts |= eyes or {"eyes": np.zeros((1, 6), np.float32)}
            parts["fingers"] = np.zeros((1, 90), np.float32)
        lengths = {name: len(part) for name, part in parts.items() if part is not None}
        if hands is not None:
            lengths["its hand poses"] = len(hands.values)
        frames = max(lengths.values(), default=0)
        for name, length in lengths.items():
            if length == 0:
                faults.add(f"{self.path}: {name} holds no frame")
            elif length not in (1, frames):
                longest = max(lengths, key=lambda name: lengths[name])
                faults.add(f"{self.path}: {name} has {length} frames and {longest} {frames}: they must agree")
        faults.stop()
        poses = np.concatenate([np.broadcast_to(part, (frames, part.shape[1])) for part in parts.values()], 1)
        poses = poses.reshape(frames, -1, 3)
        self.notes += check_angles(self.path, body, poses)
        return with_hands(poses, hands)

    def _turned(self, key: str, width: int | None) -> np.ndarray:
        return self.turned(key, width)[0]

    def _face(self, keys: tuple, width: int) -> dict[str, np.ndarray]:
        """A part of the face by its field's name, (T, width), or nothing; a pair of keys stands for its two halves."""
        for key in keys:
            names = flat((key,))
            if all(name in self.arrays for name in names):
                faults = Faults(collect=True)
                halves = [faults.of(self._turned, name, width // len(names)) for name in names]
                faults.stop()
                frames = max(map(len, halves))
                if any(len(half) not in (1, frames) for half in halves):
                    raise UserError(f"{self.path}: {' and '.join(names)} have different numbers of frames")
                whole = [np.broadcast_to(half, (frames, half.shape[1])) for half in halves]
                return {" and ".join(names): np.concatenate(whole, 1)}
        return {}

    def _expression(self, frames: int | None) -> np.ndarray | None:
        """(T, E), one row repeated."""
        key = self.key(EXPRESSION_KEYS)
        if key is None or np.size(self.arrays[key]) == 0:
            return None
        expression = self.numbers(key)
        expression = expression.reshape(1, -1) if expression.ndim == 1 else expression
        if expression.ndim != 2 or (frames is not None and len(expression) not in (1, frames)):
            raise UserError(f"{self.path}: {key} has shape {expression.shape}, expected ({frames or 'T'}, E)")
        expression = self.finite(key, expression)
        return np.repeat(expression, frames, 0) if frames and len(expression) == 1 else expression

    def _trans(self, frames: int | None) -> np.ndarray:
        """(T, 3); frames: None where the poses could not be read."""
        key = self.key(TRANS_KEYS)
        if key is None:
            return np.zeros((frames or 0, 3), np.float32)
        trans = self.numbers(key)
        if frames is None and trans.ndim == 2:
            frames = len(trans)
        if trans.ndim == 3 and trans.shape[-1] == 3 and trans.size == 3 * (frames or 0):
            trans = trans.reshape(-1, 3)  # (T, 1, 3) or (1, T, 3)
        trans = trans[None] if trans.shape == (3,) and frames == 1 else trans
        if trans.shape != (frames, 3):
            raise UserError(f"{self.path}: {key} has shape {trans.shape}, expected ({frames}, 3) to match poses")
        return self.finite(key, trans)

    def _fps(self, asked: float, default: float, frames: int | None) -> float:
        asked, key = asked_rate(asked), self.key(FRAME_RATE_KEYS)
        if asked or (key is None and default):
            return asked or default
        if key is None:
            if frames != 1:
                self.notes.append(
                    f"the file states no frame rate: {ASSUMED_FPS:g} a second are taken; `fps=25` (or what it is) "
                    "says another"
                )
            return ASSUMED_FPS
        value = _number_in_text(self.arrays[key])
        value = self.numbers(key) if value is None else value
        return stated_rate(self.path, key, float(value.reshape(-1)[0]) if value.size == 1 else np.nan, frames or 0)

    def _betas(self) -> np.ndarray | None:
        key = self.key(BETAS_KEYS)
        if key is None or np.size(self.arrays[key]) == 0:
            return None
        betas = self.numbers(key)
        betas = betas.reshape(-1, betas.shape[-1])[:1] if betas.ndim > 1 else betas  # one shape a frame: the first
        return self.finite("betas", betas.reshape(1, -1))[0]

    def _leg_length(self) -> float | None:
        if "leg_length" not in self.arrays:
            return None
        value = self.numbers("leg_length")
        if value.size != 1 or not 0 < float(value.reshape(-1)[0]) < np.inf:
            raise UserError(f"{self.path}: leg_length must be one positive number of metres")
        return float(value.reshape(-1)[0])


def _number_in_text(value: Any) -> np.ndarray | None:
    """(1,) a number that is stored as text, as `np.savez(fps="30")` leaves it; None for anything else."""
    array = as_array(value)
    if array is None or array.size != 1 or array.dtype.kind not in "US":
        return None
    text = array.reshape(-1)[0]
    try:
        return np.array([float(text.decode("ascii", "replace") if isinstance(text, bytes) else text)])
    except ValueError:
        return None
