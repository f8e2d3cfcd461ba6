"""What of a training is worth keeping, decided by rendering: refined poses, and dynamics."""

from __future__ import annotations

import math

import numpy as np
import torch

from ..scene import Scene
from ..verdicts import DynamicsVerdict, Look

WORST_ALLOWED = 0.05  # dB by which the worst view may be worse
LEAST_DETAIL = 0.95  # of the static avatar's, in a motion that nobody filmed


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


def dynamics_verdict(static: Look, dynamic: Look, least_gain: float) -> DynamicsVerdict:
    """Whether dynamics pay: kept only if nothing speaks against them. The mean gain in dB over views that they did not
    learn from is at least `least_gain` and twice its own standard error, so that a gain by chance is not kept; the
    worst view is no worse, nor the mean perceptual distance; and in a motion that nobody filmed the detail stays.

    static, dynamic: both looks in the same views.
    """
    errors = [np.maximum(look.errors, 1e-10) for look in (static, dynamic)]
    gains = 10 * np.log10(errors[0] / errors[1])
    gain = float(gains.mean())
    error = float(gains.std(ddof=1) / math.sqrt(len(gains))) if len(gains) > 1 else math.inf
    worst = float(10 * np.log10(errors[0].max() / errors[1].max()))
    perceptual = None
    if static.distances and dynamic.distances:
        perceptual = float(np.mean(dynamic.distances)) / max(float(np.mean(static.distances)), 1e-9)
    detail = dynamic.detail / static.detail if static.detail > 0 else None
    objections = {
        "no gain": gain < least_gain,
        "a gain that may be chance": gain <= 2 * error,
        "the worst view is worse": worst < -WORST_ALLOWED,
        "it looks less alike": perceptual is not None and perceptual > 1,
        "detail is lost": detail is not None and detail < LEAST_DETAIL,
    }
    against = [text for text, holds in objections.items() if holds]
    return DynamicsVerdict(
        kept=not against,
        gain_db=round(gain, 3),
        standard_error_db=round(error, 3) if math.isfinite(error) else None,
        views=len(gains),
        worst_gain_db=round(worst, 3),
        perceptual_ratio=None if perceptual is None else round(perceptual, 4),
        detail_ratio=None if detail is None else round(detail, 4),
        against=against,
    )
