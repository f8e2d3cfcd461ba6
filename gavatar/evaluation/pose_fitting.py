"""Poses fitted to the images of a scene while its avatar stays as it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from gavatar_runtime.progress import shown
from gavatar_runtime.values.motion import Motion

from ..attributes import Attributes
from ..avatar.trainable import Pose
from ..config import MotionConfig
from ..losses import LossComposer, LossInputs, judging_poses
from ..training.footage import Comparison
from ..training.motion_table import RowAdam
from ..training.scene import Scene

CHUNK = 8  # views drawn at a time
LEAST_RATE = 0.05  # of the first


def fit_poses(
    scene: Scene,
    attributes: Mapping[int, Attributes],
    losses: Mapping[str, Any],
    options: MotionConfig,
    steps: int,
    *,
    scale: float = 1.0,
    progress: bool = True,
) -> Motion:
    """The scene's motion with the frames of its views fitted to their images.

    The same losses and row-wise Adam as stage 1, its rates falling by a cosine; every view is seen at every step.
    attributes: of each frame, as decoded; they stay. losses: those of the training. scale: of the images.
    """
    table, frames = scene.motion, scene.frames
    composer = LossComposer(judging_poses(losses))
    rates = options.lr, options.lr_trans
    optimizer = RowAdam([{"params": [p]} for p in (table.rotation_correction, table.trans_correction)])
    for step in shown(range(steps), "fitting held-out poses", "step", show=progress):
        factor = 0.5 * (1 + np.cos(np.pi * step / max(1, steps)))
        for group, rate in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = rate * max(LEAST_RATE, factor)
        optimizer.zero_grad()
        for start in range(0, len(scene.views), CHUNK):
            rows = range(start, min(start + CHUNK, len(scene.views)))
            pose = table(frames)
            seen = _seen(scene, rows, scale, attributes, pose)
            motion = table.state(frames, pose)
            inputs = LossInputs(render=seen.render, target=seen.target, alpha=seen.alpha, mask=seen.mask, motion=motion)
            composer(inputs)[0].backward()
        optimizer.step(torch.tensor(frames, device=scene.device))
    return table.motion("fitted")


def _seen(scene: Scene, rows: range, scale: float, attributes: Mapping[int, Attributes], pose: Pose) -> Comparison:
    """The views in `rows`, each drawn with the attributes of its own frame. pose: of all frames of the scene."""
    parts = []
    for row in rows:
        frame = scene.views[row].frame
        at = scene.frames.index(frame)
        parts.append(scene.compare([row], scale, attributes[frame], pose=pose[at : at + 1]))
    return Comparison.joined(parts)
