"""What of a training is worth keeping, decided by rendering: refined poses, and dynamics."""

from __future__ import annotations

import math

import numpy as np
import torch

from ..scene import Scene
from ..verdicts import DynamicsVerdict

HELD_OUT_EVERY = 8  # with dynamics=auto, the share of training views that stage 2 does not see


@torch.no_grad()
def refuse_worse_poses(scene: Scene, image: float, dynamic: bool = False) -> list[int]:
    """Give frames whose refined pose renders worse than the estimated one their estimate back; returns those frames.

    Both are rendered, in images of the scale `image`, with the avatar that training ended with. It grew on the refined
    poses, so a refined pose is given the benefit of the doubt, and only what does not even pay there is refused.
    """
    rows, table = list(range(len(scene.views))), scene.motion
    estimated = scene.errors(rows, image, dynamic=dynamic, poses=lambda frame: table.estimated([frame]))
    gain = estimated - scene.errors(rows, image, dynamic=dynamic)
    shown = np.array(scene.frames_of(rows))
    refused = [frame for frame in scene.frames if gain[shown == frame].sum() < 0]
    table.rotation_correction[refused] = 0
    table.trans_correction[refused] = 0
    scene.moved(refused)
    return refused


def held_out_rows(count: int) -> list[int]:
    """The training views that `dynamics=auto` keeps from stage 2: every eighth, from the middle of the first eight."""
    return list(range(HELD_OUT_EVERY // 2, count, HELD_OUT_EVERY))


def dynamics_verdict(static: np.ndarray, dynamic: np.ndarray, least_gain: float) -> DynamicsVerdict:
    """Whether dynamics pay: the mean gain in dB over held-out views is at least `least_gain` and twice its own
    standard error, so that a gain by chance is not kept. static, dynamic: (V,) mean squared errors of the same views.
    """
    gains = 10 * (np.log10(np.maximum(static, 1e-10)) - np.log10(np.maximum(dynamic, 1e-10)))
    gain = float(gains.mean())
    error = float(gains.std(ddof=1) / math.sqrt(len(gains))) if len(gains) > 1 else math.inf
    return DynamicsVerdict(
        kept=bool(gain >= least_gain and gain > 2 * error),
        gain_db=round(gain, 3),
        standard_error_db=round(error, 3) if math.isfinite(error) else None,
        views=len(gains),
    )
