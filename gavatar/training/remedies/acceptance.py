"""What of a training is worth keeping, decided by rendering: refined poses, and dynamics."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from ..trainer import Trainer

HELD_OUT_EVERY = 8  # with dynamics=auto, the share of training views that stage 2 does not see


@torch.no_grad()
def view_errors(
    trainer: Trainer,
    rows: list[int],
    stage: int,
    *,
    pose: Callable[[int], tuple[Tensor, Tensor]] | None = None,
    image: float | None = None,
) -> np.ndarray:
    """(V,) mean squared error on white of training views `rows`.

    stage 2 renders with the pose encoder, 1 without. pose: a frame's (1, J, 3, 3) rotations and (1, 3) translation, by
    default as refined; the encoder looks at the refined motion. image: scale of the images, by default the stage's
    last.
    """
    avatar, table = trainer.avatar, trainer.motion
    data = trainer.footage_at(image or getattr(trainer.config, f"stage{stage}").levels[-1].image)
    background = torch.ones(3)
    training = avatar.training
    avatar.eval()
    static = avatar.attributes() if stage == 1 else None
    errors = []
    for row in rows:
        frame = data.views[row].frame
        attributes = static or avatar.attributes(avatar.encode(*trainer.pose_inputs([frame])))
        rotations, trans = table([frame]) if pose is None else pose(frame)
        (gaussians,) = avatar.pose(attributes, rotations, trans, table.expression([frame]), trainer.shape_change())
        drawn = trainer.rasterize(gaussians, data.cameras[row], background.to(trainer.device))
        alpha = drawn.alpha[None]
        render = trainer.seen([row], drawn.color.permute(2, 0, 1)[None], alpha, background)
        target, render, *_ = data.believed([row], *data.batch([row], background, trainer.device), render, alpha)
        errors.append(float((render - target).square().mean()))
    avatar.train(training)
    return np.array(errors)


@torch.no_grad()
def refuse_worse_poses(trainer: Trainer, stage: int = 1) -> list[int]:
    """Give frames whose refined pose renders worse than the estimated one their estimate back; returns those frames.

    Both are rendered with the avatar that training ended with. It grew on the refined poses, so a refined pose is
    given the benefit of the doubt, and only what does not even pay there is refused.
    """
    rows = list(range(len(trainer.views)))
    gain = view_errors(trainer, rows, stage, pose=trainer.motion.estimated) - view_errors(trainer, rows, stage)
    frames = np.array([view.frame for view in trainer.views])
    refused = [frame for frame in trainer.frames if gain[frames == frame].sum() < 0]
    trainer.motion.rotation_correction[refused] = 0
    trainer.motion.trans_correction[refused] = 0
    trainer.moved(refused)
    return refused


def held_out_rows(count: int) -> list[int]:
    """The training views that `dynamics=auto` keeps from stage 2: every eighth, from the middle of the first eight."""
    return list(range(HELD_OUT_EVERY // 2, count, HELD_OUT_EVERY))


def dynamics_verdict(static: np.ndarray, dynamic: np.ndarray, least_gain: float) -> dict[str, Any]:
    """Whether dynamics pay: the mean gain in dB over held-out views is at least `least_gain` and twice its own
    standard error, so that a gain by chance is not kept. static, dynamic: (V,) mean squared errors of the same views.
    """
    gains = 10 * (np.log10(np.maximum(static, 1e-10)) - np.log10(np.maximum(dynamic, 1e-10)))
    gain = float(gains.mean())
    error = float(gains.std(ddof=1) / math.sqrt(len(gains))) if len(gains) > 1 else math.inf
    return {
        "kept": bool(gain >= least_gain and gain > 2 * error),
        "gain_db": round(gain, 3),
        "standard_error_db": round(error, 3) if math.isfinite(error) else None,
        "views": len(gains),
    }
