"""Penalty on acceleration."""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor

from gavatar.body.torch_rotations import rotation_vector_from_matrix
from gavatar.losses import LossConfig, LossInputs
from gavatar.registry import LOSSES
from gavatar_runtime.errors import UserError

# Accelerations are stated per square thirtieth of a second: then the penalty on a jitter of a given angle at 30 frames
# a second is about the square of that angle, and a weight means the same at every frame rate
UNIT_TIME = 1 / 30


@dataclasses.dataclass
class MotionSmoothnessConfig(LossConfig):
    """weight: not in the paper. translation: square radians that a square metre counts for. max_gap: seconds; three
    frames of which two neighbours are further apart say nothing about acceleration and are left out. robust: rad (m for
    the root's path, by `translation`) per (s/30)^2 at which the penalty turns from square to linear; 0: square
    throughout. People stand, swing and stop: most accelerations are next to none and a few are large, while an
    estimate's jitter is the same everywhere, so a penalty that spares the few can weigh more on the many."""

    weight: float = 1.0
    translation: float = 1.0
    max_gap: float = 0.25
    robust: float = 0.0


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
        if not (math.isfinite(config.robust) and config.robust >= 0):
            raise UserError(f"losses.motion_smoothness.robust: must be a number of at least 0, not {config.robust!r}")
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
        rotation = self._penalty(spin.square().sum(-1)).mean(1) @ weight
        return rotation + self._penalty(self.config.translation * push.square().sum(-1)) @ weight

    def _penalty(self, squares: Tensor) -> Tensor:
        """`squares`, growing like the root above `robust`^2 (Charbonnier): 2 c (sqrt(c^2 + a^2) - c), written so that
        nothing cancels at a = 0."""
        c = self.config.robust
        return squares if c == 0 else 2 * c * squares / ((squares + c * c).sqrt() + c)
