"""Motions in pickles: AIST++ `.pkl` (Li et al. 2021), upstream GaussianAvatar's `smpl_parms.pth`. Nothing in them is
executed."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..formats.safe_pickle import load_pickle
from ..formats.torch_file import load_torch
from ..values.motion import Motion
from .fields import SmplFields, check_up
from .source import MOTIONS

AIST_FPS = 60.0  # of the data set's videos; its files do not say
EDGE_FPS = 30.0  # of dances by EDGE (Tseng et al. 2023), which are told by their joint positions, full_pose (T, 24, 3)
UPSTREAM_FPS = 30.0  # of phone video; upstream's files do not say either


@dataclasses.dataclass
class PickleOptions:
    """up: the file's vertical axis, `y`, `z`, `-y` or `auto`: the one that the pelvis points along on average. fps: 0
    is the file's own or, where it states none, the format's: 60 for AIST++, 30 for EDGE and .pth. hands, hand_mean: as
    of .npz."""

    up: str = "auto"
    fps: float = 0.0
    hands: str = "auto"
    hand_mean: str = "auto"


class _Pickled:
    """A file whose pickle holds a dictionary of arrays."""

    suffixes: tuple[str, ...] = ()
    default_fps = 30.0

    def __init__(self, config: PickleOptions, *, path: Path):
        check_up(config.up)
        self.config, self.path = config, path

    def arrays(self) -> dict:
        raise NotImplementedError

    def load(self) -> Motion:
        """The motion, y-up, float32; UserError naming file and field."""
        arrays = self.arrays()
        if not isinstance(arrays, dict):
            raise UserError(f"{self.path} holds a {type(arrays).__name__}, expected a dictionary of arrays")
        config = self.config
        arrays = {str(key): value for key, value in arrays.items()}
        fields = SmplFields(self.path, arrays, hands=config.hands, hand_mean=config.hand_mean)
        return fields.motion(
            up=config.up, fps=config.fps, default_fps=self._default_fps(arrays), trans_scale=self._trans_scale(arrays)
        )

    def _trans_scale(self, arrays: dict) -> float:
        return 1.0

    def _default_fps(self, arrays: dict) -> float:
        return self.default_fps


@MOTIONS.register("aist", config=PickleOptions, summary="AIST++ .pkl: smpl_poses, smpl_trans, smpl_scaling")
class AistFile(_Pickled):
    """smpl_poses (T, 72), smpl_trans (T, 3) in the units of the cameras, smpl_scaling (1,): a body's metre in them, so
    that smpl_trans / smpl_scaling is metres (aist_plusplus/loader.py, visualizer.py). EDGE writes the same fields in
    metres. Other pickles of SMPL fields are read as well."""

    suffixes = (".pkl", ".pickle")
    default_fps = AIST_FPS

    def arrays(self) -> dict:
        return load_pickle(self.path)

    def _trans_scale(self, arrays: dict) -> float:
        if "smpl_scaling" not in arrays:
            return 1.0
        scaling = np.asarray(arrays["smpl_scaling"])
        if scaling.size != 1 or scaling.dtype.kind not in "fiu" or not 0 < float(scaling.reshape(-1)[0]) < np.inf:
            raise UserError(f"{self.path}: smpl_scaling must be one positive number")
        return 1 / float(scaling.reshape(-1)[0])

    def _default_fps(self, arrays: dict) -> float:
        return EDGE_FPS if "full_pose" in arrays and "smpl_scaling" not in arrays else self.default_fps


@MOTIONS.register("torch", config=PickleOptions, summary=".pth of tensors: upstream's smpl_parms.pth, SMPL fields")
class TorchFile(_Pickled):
    """body_pose (T, 72 or 165) with the root first, trans (T, 3), beta; or SMPL fields. Read without torch."""

    suffixes = (".pth", ".pt")
    default_fps = UPSTREAM_FPS

    def arrays(self) -> dict:
        return load_torch(self.path)
