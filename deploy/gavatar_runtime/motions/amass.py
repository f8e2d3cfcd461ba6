"""Motions in AMASS's `.npz` layout (Mahmood et al. 2019), which is also what a gavatar capture's body.npz holds."""

from __future__ import annotations

import dataclasses
import zipfile
import zlib
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..motion import Motion
from ..rotations import axis_angle_from_matrix, matrix_from_axis_angle
from .source import MOTIONS

FRAME_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate")
Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@dataclasses.dataclass
class AmassOptions:
    """up: the file's vertical axis, `y`, `z` or `auto`; AMASS's own files are z-up, gavatar's are y-up, and neither
    says so: `auto` takes the axis that the pelvis points along on average. fps: overrides the file's, 0 keeps it."""

    up: str = "auto"
    fps: float = 0.0


@MOTIONS.register("amass", config=AmassOptions, summary="AMASS .npz: poses, trans, mocap_framerate, optional betas")
class AmassFile:
    """Keys: poses (T, 3J) or (T, J, 3) axis-angle, radians; trans (T, 3), metres, zero if absent; mocap_framerate or
    mocap_frame_rate; betas, optional. Other keys (gender, dmpls, markers) are left alone."""

    suffixes = (".npz",)

    def __init__(self, config: AmassOptions, *, path: Path):
        if config.up not in ("auto", "y", "z"):
            raise UserError(f"motion option up={config.up}: choose from auto, y, z")
        if not isinstance(config.fps, (int, float)):
            raise UserError(f"motion option fps={config.fps}: give a number of frames per second, 0 for the file's own")
        self.config = config
        self.path = path

    def load(self) -> Motion:
        """The motion, y-up, float32. UserError naming the file and the key for anything missing, misshaped, not finite
        or not a plain array."""
        arrays = _read_arrays(self.path)
        poses = self._poses(arrays)
        trans = self._trans(arrays, len(poses))
        motion = Motion(poses, trans, self._fps(arrays), self._betas(arrays), self.path.stem)
        up = self.config.up if self.config.up != "auto" else _vertical_axis(poses)
        return _y_up_from_z_up(motion) if up == "z" else motion

    def _poses(self, arrays: dict[str, np.ndarray]) -> np.ndarray:
        if "poses" not in arrays:
            raise UserError(
                f"{self.path}: key 'poses' is missing; a motion holds poses (T, 3J), trans (T, 3) and mocap_framerate, "
                f"this file holds {', '.join(sorted(arrays)) or 'nothing'}"
            )
        poses = self._numbers(arrays, "poses")
        if poses.ndim == 3 and poses.shape[2] == 3:
            poses = poses.reshape(len(poses), -1)
        if poses.ndim != 2 or poses.shape[1] % 3 or poses.shape[1] == 0:
            raise UserError(
                f"{self.path}: poses has shape {poses.shape}, expected (T, 3J), three axis-angle numbers a joint"
            )
        if len(poses) == 0:
            raise UserError(f"{self.path}: poses holds no frame")
        return self._finite("poses", poses).reshape(len(poses), -1, 3)

    def _trans(self, arrays: dict[str, np.ndarray], frames: int) -> np.ndarray:
        if "trans" not in arrays:
            return np.zeros((frames, 3), np.float32)
        trans = self._numbers(arrays, "trans")
        if trans.shape != (frames, 3):
            raise UserError(f"{self.path}: trans has shape {trans.shape}, expected ({frames}, 3) to match poses")
        return self._finite("trans", trans)

    def _fps(self, arrays: dict[str, np.ndarray]) -> float:
        if self.config.fps:
            fps, key = float(self.config.fps), "the option fps"
        else:
            key = next((k for k in FRAME_RATE_KEYS if k in arrays), None)
            if key is None:
                raise UserError(f"{self.path}: key 'mocap_framerate' is missing; add it or give the option fps")
            value = self._numbers(arrays, key)
            fps = float(value.reshape(-1)[0]) if value.size == 1 else np.nan
        if not (np.isfinite(fps) and fps > 0):
            raise UserError(f"{self.path}: {key} must be one positive number of frames per second")
        return fps

    def _betas(self, arrays: dict[str, np.ndarray]) -> np.ndarray | None:
        if "betas" not in arrays:
            return None
        return self._finite("betas", self._numbers(arrays, "betas").reshape(1, -1))[0]

    def _numbers(self, arrays: dict[str, np.ndarray], key: str) -> np.ndarray:
        array = arrays[key]
        if array.dtype.kind not in "fiu":
            raise UserError(f"{self.path}: {key} holds {array.dtype} values, expected numbers")
        return array

    def _finite(self, key: str, array: np.ndarray) -> np.ndarray:
        """(T, ...) as float32; what overflows there counts as infinite too."""
        with np.errstate(over="ignore"):
            array = np.asarray(array, np.float32)
        bad = ~np.isfinite(array.reshape(len(array), -1)).all(1)
        if bad.any():
            where = "" if key == "betas" else f", first at frame {int(np.argmax(bad))}"
            raise UserError(f"{self.path}: {key} holds NaN or infinite values{where}")
        return array


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz by name, pickles refused. An array that cannot be read is an error only if it is one that a
    motion needs: AMASS files carry object arrays among their extras."""
    needed = {"poses", "trans", "betas", *FRAME_RATE_KEYS}
    try:
        file = np.load(path, allow_pickle=False)
        if not isinstance(file, np.lib.npyio.NpzFile):
            raise UserError(f"{path} is a single array (.npy), not an .npz of named arrays")
        with file:
            return {key: _read_array(file, key, path) if key in needed else np.zeros(0) for key in file.files}
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, OSError) as error:
        raise UserError(f"{path} is empty, damaged or not an .npz file") from error


def _read_array(file: np.lib.npyio.NpzFile, key: str, path: Path) -> np.ndarray:
    try:
        return file[key]
    except ValueError as error:
        raise UserError(f"{path}: {key} is not a plain array of numbers; pickled objects are not read") from error


def _vertical_axis(poses: np.ndarray) -> str:
    """`z` if the pelvis' own up axis points along z rather than y on average over the frames, else `y`."""
    up = matrix_from_axis_angle(poses[:, 0].astype(np.float64))[:, :, 1].mean(0)
    return "z" if up[2] > abs(up[1]) else "y"


def _y_up_from_z_up(motion: Motion) -> Motion:
    """The same motion in a y-up world. (The pelvis' rest offset is left out of the turn: it depends on the body and
    shifts every frame alike.)"""
    poses = motion.poses.copy()
    poses[:, 0] = axis_angle_from_matrix(Y_UP_FROM_Z_UP @ matrix_from_axis_angle(poses[:, 0].astype(np.float64)))
    trans = (motion.trans @ Y_UP_FROM_Z_UP.T).astype(np.float32)
    return dataclasses.replace(motion, poses=poses, trans=trans)
