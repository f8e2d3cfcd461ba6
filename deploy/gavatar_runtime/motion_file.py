"""Writing motions."""

from __future__ import annotations

import os

import numpy as np

from .files import atomic
from .motion import Motion


def write_motion(path: str | os.PathLike, motion: Motion) -> None:
    """Write a motion with AMASS keys, which every reader of such files takes."""
    with atomic(path) as temporary:
        np.savez(
            temporary,
            poses=motion.poses.reshape(len(motion), -1).astype(np.float32),
            trans=motion.trans.astype(np.float32),
            betas=np.zeros(0) if motion.betas is None else motion.betas,
            mocap_framerate=np.float64(motion.fps),
            gender=np.array("neutral"),
            **({} if motion.leg_length is None else {"leg_length": np.float64(motion.leg_length)}),
        )
