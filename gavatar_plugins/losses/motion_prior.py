"""Keeps the motion near its estimate."""

from __future__ import annotations

import dataclasses

from torch import Tensor

from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES


@dataclasses.dataclass
class MotionPriorConfig(LossConfig):
    """weight: not in the paper. translation: square radians that a square metre counts for. betas: those that a squared
    shape coefficient counts for, where the shape is optimised."""

    weight: float = 0.1
    translation: float = 1.0
    betas: float = 1e-3


@LOSSES.register("motion_prior", config=MotionPriorConfig, summary="squared distance of the motion from its estimate")
class MotionPrior:
    """Mean over frames and joints of 2 - 2 cos(angle to the initial rotation), plus `translation` times the mean over
    frames of the squared distance (m^2) to the initial translation, plus `betas` times the squared change of the shape;
    abstains where poses are fixed.

    2 - 2 cos(angle) = |R - R_initial|^2 / 2 is the squared angle where that is small, and smooth at 0 and at pi.
    """

    def __init__(self, config: MotionPriorConfig):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor | None:
        if inputs.motion is None:
            return None
        motion = inputs.motion
        rotation = (motion.rotations - motion.rotations_initial).square().sum((-2, -1)).mean() / 2
        change = rotation + self.config.translation * (motion.trans - motion.trans_initial).square().sum(-1).mean()
        if motion.betas_change is not None:
            change = change + self.config.betas * motion.betas_change.square().sum()
        return change
