"""Motions in `.npz` files: AMASS (Mahmood et al. 2019), SMPL, SMPL-H and SMPL-X parameters, a capture's body.npz."""

from __future__ import annotations

import dataclasses
import zipfile
import zlib
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..values.motion import Motion
from .fields import KEYS, SmplFields, check_up
from .source import MOTIONS


@dataclasses.dataclass
class AmassOptions:
    """up: the file's vertical axis, `y`, `z`, `-y` or `auto`; AMASS's own files are z-up, gavatar's are y-up, and
    neither says so: `auto` takes the axis that the pelvis points along on average. fps: overrides the file's, 0 keeps
    it; owed where a file states none. hands: `full` rotations or `pca` coefficients; hand_mean: about the `flat` or the
    `mean` hand; `auto` as `SmplFields` tells them."""

    up: str = "auto"
    fps: float = 0.0
    hands: str = "auto"
    hand_mean: str = "auto"


@MOTIONS.register("amass", config=AmassOptions, summary="AMASS and SMPL/SMPL-H/SMPL-X .npz, by their field names")
class AmassFile:
    """Reads the fields that `SmplFields` names; other keys (gender, dmpls, markers) are left alone."""

    suffixes = (".npz",)

    def __init__(self, config: AmassOptions, *, path: Path):
        check_up(config.up)
        if not isinstance(config.fps, (int, float)):
            raise UserError(f"motion option fps={config.fps}: give a number of frames per second, 0 for the file's own")
        self.config = config
        self.path = path

    def load(self) -> Motion:
        """The motion, y-up, float32. UserError naming the file and the key for anything missing, misshaped, not finite
        or not a plain array."""
        config = self.config
        fields = SmplFields(self.path, read_arrays(self.path), hands=config.hands, hand_mean=config.hand_mean)
        return fields.motion(up=config.up, fps=config.fps)


def read_arrays(path: Path) -> dict[str, np.ndarray | UserError]:
    """The arrays of an .npz by name, pickles refused. In place of an array that cannot be read stands the UserError,
    if it is one that a motion needs: AMASS files carry object arrays among their extras. Raises UserError."""
    try:
        file = np.load(path, allow_pickle=False)
        if not isinstance(file, np.lib.npyio.NpzFile):
            raise UserError(f"{path} is a single array (.npy), not an .npz of named arrays")
        with file:
            return {key: _read_array(file, key, path) if key in KEYS else np.zeros(0) for key in file.files}
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, OSError) as error:
        raise UserError(f"{path} is empty, damaged or not an .npz file") from error


def _read_array(file: np.lib.npyio.NpzFile, key: str, path: Path) -> np.ndarray | UserError:
    try:
        return file[key]
    except ValueError:
        return UserError(f"{path}: {key} is not a plain array of numbers; pickled objects are not read")
