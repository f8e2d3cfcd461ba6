"""Penalty on acceleration."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES
from gavatar.rotations import rotation_vector_from_matrix

# Accelerations are stated per square thirtieth of a second: then the penalty on a jitter of a given angle at 30 frames
# a second is about the square of that angle, and a weight means the same at every frame rate
UNIT_TIME = 1 / 30


@dataclasses.dataclass
class MotionSmoothnessConfig(LossConfig):
    """weight: not in the paper. translation: square radians that a square metre counts for. max_gap: seconds; three
    frames of which two neighbours are further apart say nothing about acceleration and are left out."""

    weight: float = 1.0
    translation: float = 1.0
    max_gap: float = 0.25


@LOSSES.register("motion_smoothness", config=MotionSmoothnessConfig, summary="mean squared acceleration of the motion")
class MotionSmoothness:
    """Time average of the squared acceleration, in (rad / (s/30)^2)^2, mean over joints, plus `translation` times that
    of the root in (m / (s/30)^2)^2. Abstains where poses are fixed or no three frames are near enough.

    Of every three successive frames: velocity = rotation vector of R_a^T R_b over the time between, acceleration =
    difference of the two velocities over the time between the middles. That is zero for turning at a steady rate
    however the frames are spaced, and of a smooth motion it does not depend on the frame rate. Each triplet counts for
    the time that it covers. The motion itself is smoothed, not its correction: the estimate is what jitters.
    """

    def __init__(self, config: MotionSmoothnessConfig):
        self.config = config

    def __call__(self, inputs: LossInputs) -> Tensor | None:
        if inputs.motion is None or len(inputs.motion.frame_times) < 3:
            return None
        motion = inputs.motion
        step = motion.frame_times.diff() / UNIT_TIME
        near = (step > 0) & (step * UNIT_TIME <= self.config.max_gap)
        valid = near[1:] & near[:-1]
        if not bool(valid.any()):
            return None
        step = torch.where(near, step, torch.ones_like(step))
        span = (step[1:] + step[:-1]) / 2
        weight = torch.where(valid, span, torch.zeros_like(span))
        weight = weight / weight.sum()
        turn = rotation_vector_from_matrix(motion.rotations[:-1].mT @ motion.rotations[1:])
        spin = (turn / step[:, None, None]).diff(dim=0) / span[:, None, None]
        push = (motion.trans.diff(dim=0) / step[:, None]).diff(dim=0) / span[:, None]
        rotation = spin.square().sum(-1).mean(1) @ weight
        return rotation + self.config.translation * (push.square().sum(-1) @ weight)
