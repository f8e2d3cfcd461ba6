"""From the named arrays of a file to a motion: the field names of the SMPL family's many writers, and their axes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Faults, UserError, frames_named
from ..geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from ..values.motion import HandParameters, Motion

FRAME_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps", "frame_rate")
WHOLE_KEYS = ("poses", "fullpose", "thetas", "smpl_poses", "pose")
ROOT_KEYS = ("root_orient", "global_orient")
BODY_KEYS = ("pose_body", "body_pose")
JAW_KEYS = ("pose_jaw", "jaw_pose")
EYE_KEYS = ("pose_eye", ("leye_pose", "reye_pose"))
HAND_KEYS = ("pose_hand", ("left_hand_pose", "right_hand_pose"))
TRANS_KEYS = ("trans", "transl", "smpl_trans")
BETAS_KEYS = ("betas", "beta", "shapes")
EXPRESSION_KEYS = ("expression", "expressions", "expr")
PCA_KEY, FLAT_KEY = "use_pca", "flat_hand_mean"  # smplx's words for how hand poses are to be read
HANDS = ("auto", "full", "pca")
HAND_MEANS = ("auto", "flat", "mean")
# Numbers a frame of SMPL-H poses with 6 or 12 coefficients a hand, as MANO's own loader has them (66 + 2 K)
COMPACT = {78: 6, 90: 12}


def _flat(keys: tuple) -> tuple[str, ...]:
    return tuple(k for key in keys for k in (key if isinstance(key, tuple) else (key,)))


KEYS = (
    *WHOLE_KEYS, *ROOT_KEYS, *BODY_KEYS, *JAW_KEYS, *_flat(EYE_KEYS), *_flat(HAND_KEYS), *TRANS_KEYS, *BETAS_KEYS,
    *FRAME_RATE_KEYS, *EXPRESSION_KEYS, PCA_KEY, FLAT_KEY, "leg_length",
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
    zero if absent; betas (or beta); mocap_framerate (or mocap_frame_rate, fps); expression, (T, E), one row for all
    frames or none; leg_length, optional, as `Motion` has it.

    Hands of 45 numbers are rotations, about the flat hand (AMASS); of fewer, coefficients of a model's principal
    components about its mean hand (smplx). use_pca and flat_hand_mean in the file say otherwise, and so do hands:
    `full`, `pca` or `auto`, and hand_mean: `flat`, `mean` or `auto`.
    Raises UserError for another word.
    """

    def __init__(self, path: Path, arrays: Mapping[str, Any], *, hands: str = "auto", hand_mean: str = "auto"):
        for name, value, known in (("hands", hands, HANDS), ("hand_mean", hand_mean, HAND_MEANS)):
            if value not in known:
                raise UserError(f"motion option {name}={value}: choose from {', '.join(known)}")
        self.path, self.arrays, self.hands, self.hand_mean = path, arrays, hands, hand_mean

    def motion(self, *, up: str, fps: float, default_fps: float = 0.0, trans_scale: float = 1.0) -> Motion:
        """The motion, y-up, float32.

        up: as in `y_up`. fps: overrides the file's rate, 0 keeps it. default_fps: of a format that states none.
        Raises UserError naming the file and the field for anything missing, misshaped or not finite; its `sentences`
        are one for every field at fault.
        """
        faults = Faults(collect=True)
        poses, hands = faults.of(self._posed) or (None, None)
        frames = self._rows() if poses is None else len(poses)
        trans = faults.of(self._trans, frames)
        rate = faults.of(self._fps, fps, default_fps)
        betas, leg_length = faults.of(self._betas), faults.of(self._leg_length)
        expression = faults.of(self._expression, frames)
        faults.stop()
        trans = trans * np.float32(trans_scale)
        motion = Motion(poses, trans, rate, betas, self.path.stem, leg_length, expression, hands)
        return y_up(motion, up)

    def _rows(self) -> int | None:
        """Frames of poses that could not be read, None where that cannot be told."""
        key = self._key((*WHOLE_KEYS, *BODY_KEYS))
        shape = () if key is None else np.shape(self.arrays[key])
        return shape[0] if len(shape) > 1 else None

    def _posed(self) -> tuple[np.ndarray, HandParameters | None]:
        """(T, J, 3) axis-angle of the joints, and the hands that need a model to become such."""
        key = self._key(WHOLE_KEYS)
        if key is None and self._key(ROOT_KEYS) is None:
            body = self._key(BODY_KEYS)
            key = body if body is not None and np.shape(self.arrays[body])[-1:] in ((72,), (156,), (165,)) else None
        if key is not None:
            return self._whole(key)
        if self._key(BODY_KEYS) is None or self._key(ROOT_KEYS) is None:
            raise UserError(
                f"{self.path}: key 'poses' is missing; a motion holds poses (T, 3J), trans (T, 3) and "
                f"mocap_framerate, or root_orient and pose_body; this file holds "
                f"{', '.join(sorted(self.arrays)) or 'nothing'}"
            )
        return self._assembled()

    def _whole(self, key: str) -> tuple[np.ndarray, HandParameters | None]:
        """Of one array of all joints; hands from fields of their own take the place of fingers that never move."""
        poses = self._numbers(key)
        if poses.ndim == 3 and poses.shape[2] == 3:
            poses = poses.reshape(len(poses), -1)
        if poses.ndim != 2 or poses.shape[1] % 3 or poses.shape[1] == 0:
            raise UserError(
                f"{self.path}: {key} has shape {poses.shape}, expected (T, 3J), three axis-angle numbers a joint"
            )
        if len(poses) == 0:
            raise UserError(f"{self.path}: {key} holds no frame")
        poses = self._finite(key, poses)
        width = poses.shape[1]
        if width in COMPACT or (width in (156, 165) and (self.hands == "pca" or self.hand_mean == "mean")):
            hands = self._understood(key, np.stack(np.split(poses[:, 66 if width in COMPACT else -90 :], 2, 1), 1))
            poses = poses[:, :66] if width in COMPACT else np.concatenate([poses[:, :-90], 0 * poses[:, -90:]], 1)
        elif width in (156, 165) and poses[:, -90:].any():
            hands = None
        else:
            hands = self._hands()
        poses = poses.reshape(len(poses), -1, 3)
        if hands is not None and len(hands.values) not in (1, len(poses)):
            raise UserError(
                f"{self.path}: its hand poses have {len(hands.values)} frames and {key} {len(poses)}: they must agree"
            )
        return _with_hands(poses, hands)

    def _assembled(self) -> tuple[np.ndarray, HandParameters | None]:
        """Of fields of body parts: 24 joints (a body_pose of 23), 22, 52 with hands, 55 with a face."""
        faults, root, body = Faults(collect=True), self._key(ROOT_KEYS), self._key(BODY_KEYS)
        parts = {root: faults.of(self._part, root, 3), body: faults.of(self._part, body, None)}
        width = 0 if parts[body] is None else parts[body].shape[1]
        if parts[body] is not None and width not in (63, 69):
            faults.add(f"{self.path}: {body} holds {width} numbers a frame, expected 63 (21 joints) or 69 (23)")
        jaw, eyes = faults.of(self._face, JAW_KEYS, 3), faults.of(self._face, EYE_KEYS, 6)
        hands = faults.of(self._hands)
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
                longest = max(lengths, key=lengths.get)
                faults.add(f"{self.path}: {name} has {length} frames and {longest} {frames}: they must agree")
        faults.stop()
        poses = np.concatenate([np.broadcast_to(part, (frames, part.shape[1])) for part in parts.values()], 1)
        return _with_hands(poses.reshape(frames, -1, 3), hands)

    def _face(self, keys: tuple, width: int) -> dict[str, np.ndarray]:
        """A part of the face by its field's name, (T, width), or nothing; a pair of keys stands for its two halves."""
        for key in keys:
            names = _flat((key,))
            if all(name in self.arrays for name in names):
                faults = Faults(collect=True)
                halves = [faults.of(self._part, name, width // len(names)) for name in names]
                faults.stop()
                frames = max(map(len, halves))
                if any(len(half) not in (1, frames) for half in halves):
                    raise UserError(f"{self.path}: {' and '.join(names)} have different numbers of frames")
                whole = [np.broadcast_to(half, (frames, half.shape[1])) for half in halves]
                return {" and ".join(names): np.concatenate(whole, 1)}
        return {}

    def _hands(self) -> HandParameters | None:
        """Both hands from fields of their own, or None where there are none."""
        key = next((k for k in HAND_KEYS if all(name in self.arrays for name in _flat((k,)))), None)
        if key is None:
            return None
        names, faults = _flat((key,)), Faults(collect=True)
        parts = [faults.of(self._part, name, None) for name in names]
        faults.stop()
        if len(parts) == 1:
            if parts[0].shape[1] % 2:
                raise UserError(
                    f"{self.path}: {names[0]} holds {parts[0].shape[1]} numbers a frame, which are no two hands"
                )
            parts = np.split(parts[0], 2, 1)
        frames = max(map(len, parts))
        if parts[0].shape[1] != parts[1].shape[1] or any(len(part) not in (1, frames) for part in parts):
            shapes = " and ".join(str(part.shape) for part in parts)
            raise UserError(f"{self.path}: {' and '.join(names)} have shapes {shapes}: both hands must be alike")
        both = np.stack([np.broadcast_to(part, (frames, part.shape[1])) for part in parts], 1)
        return self._understood(" and ".join(names), both)

    def _understood(self, name: str, values: np.ndarray) -> HandParameters:
        """Values (T, 2, K) with what they mean, from their number, the file's own words and the options."""
        width = values.shape[2]
        pca = {"full": False, "pca": True, "auto": self._flag(PCA_KEY, width != 45)}[self.hands]
        relative = {"flat": False, "mean": True, "auto": not self._flag(FLAT_KEY, not pca)}[self.hand_mean]
        if not 1 <= width <= 45 or (not pca and width != 45):
            raise UserError(
                f"{self.path}: {name}: {width} numbers a hand; expected 45, or up to 45 coefficients (hands=pca)"
            )
        return HandParameters(values, pca, relative)

    def _flag(self, key: str, default: bool) -> bool:
        if key not in self.arrays:
            return default
        value = np.asarray(self.arrays[key])
        if value.size != 1 or value.dtype.kind not in "biu":
            raise UserError(f"{self.path}: {key} must be true or false")
        return bool(value.reshape(-1)[0])

    def _expression(self, frames: int | None) -> np.ndarray | None:
        """(T, E), one row repeated."""
        key = self._key(EXPRESSION_KEYS)
        if key is None or np.size(self.arrays[key]) == 0:
            return None
        expression = self._numbers(key)
        expression = expression.reshape(1, -1) if expression.ndim == 1 else expression
        if expression.ndim != 2 or (frames is not None and len(expression) not in (1, frames)):
            raise UserError(f"{self.path}: {key} has shape {expression.shape}, expected ({frames or 'T'}, E)")
        expression = self._finite(key, expression)
        return np.repeat(expression, frames, 0) if frames and len(expression) == 1 else expression

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


def _with_hands(poses: np.ndarray, hands: HandParameters | None) -> tuple[np.ndarray, HandParameters | None]:
    """Poses (T, J, 3) with the hands that are rotations already, on 52 or 55 joints; those that are not, a row a frame,
    beside them."""
    if hands is None:
        return poses, None
    values = np.broadcast_to(hands.values, (len(poses), *hands.values.shape[1:]))
    if hands.pca or hands.relative:
        return poses, dataclasses.replace(hands, values=values.copy())
    body = poses[:, : 25 if poses.shape[1] == 55 else 22]
    return np.concatenate([body, values.reshape(len(poses), 30, 3)], 1), None


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
