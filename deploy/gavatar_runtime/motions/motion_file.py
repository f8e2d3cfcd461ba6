"""Writing motions."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..formats.files import atomic
from ..values.motion import HandParameters, Motion


def write_motion(path: str | os.PathLike, motion: Motion) -> None:
    """Write a motion with AMASS keys, which every reader of such files takes."""
    with atomic(path) as temporary:
        fields: dict[str, Any] = dict(
            poses=motion.poses.reshape(len(motion), -1).astype(np.float32),
            trans=motion.trans.astype(np.float32),
            betas=np.zeros(0) if motion.betas is None else motion.betas,
            mocap_framerate=np.float64(motion.fps),
            gender=np.array("neutral"),
            **({} if motion.leg_length is None else {"leg_length": np.float64(motion.leg_length)}),
            **({} if motion.expression is None else {"expression": motion.expression.astype(np.float32)}),
            **({} if motion.hands is None else _hand_fields(motion.hands)),
        )
        np.savez(temporary, **fields)


def _hand_fields(hands: HandParameters) -> dict[str, np.ndarray]:
    """Hand parameters under the names that the smplx package gives them."""
    left, right = np.moveaxis(hands.values.astype(np.float32), 1, 0)
    return {
        "left_hand_pose": left,
        "right_hand_pose": right,
        "use_pca": np.array(hands.pca),
        "flat_hand_mean": np.array(not hands.relative),
    }
