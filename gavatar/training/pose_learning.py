"""Refining a scene's poses beside its avatar: what images say of them is shared between neighbouring frames."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from ..config import MotionConfig
from ..losses import MotionState
from .motion_table import RowAdam, scale_gradient, shared_frames
from .scene import Scene


class PoseLearner:
    """Adam on the corrections of a scene's motion table, one for all stages: a frame is seen a few times in stage 2,
    and begun anew Adam's first steps would be of full length for every joint.

    leaves: of the latest `state`, by parameter: where the gradients of the motion's own terms arrive.
    """

    def __init__(self, scene: Scene, options: MotionConfig):
        self.scene, table = scene, scene.motion
        self.leaves: dict[torch.nn.Parameter, Tensor] = {}
        self._row = {frame: row for row, frame in enumerate(scene.frames)}
        self.optimizer = RowAdam(
            [
                {"params": [table.rotation_correction], "lr": options.lr},
                {"params": [table.trans_correction], "lr": options.lr_trans},
            ]
        )

    @property
    def span(self) -> float:
        """Seconds between the scene's first and last frame."""
        return (self.scene.frames[-1] - self.scene.frames[0]) / self.scene.motion.fps

    def state(self, shown: int, mended: list[int]) -> MotionState:
        """The motion of every frame of the scene for the losses, read from leaves of its own: what images say is shared
        between neighbours, what the motion's terms say must not be, for they tell frames from their neighbours. Only
        `shown` frames' images are in a step and share the image terms among themselves; the motion terms are weighed
        alike, or their weight would hang on the capture's length and, with it, on its frame rate.

        mended: frames whose estimate was found wrong; it must not draw them back."""
        scene, table, frames = self.scene, self.scene.motion, self.scene.frames
        self.leaves = {p: p.detach().requires_grad_() for p in (table.rotation_correction, table.trans_correction)}
        pose = table(frames, *self.leaves.values())
        state, share = table.state(frames, pose), len(frames) / shown
        rows = [self._row[frame] for frame in mended]
        if rows:
            state.rotations_initial[rows] = pose.rotations[rows].detach()
            state.trans_initial[rows] = pose.trans[rows].detach()
        return dataclasses.replace(
            state,
            rotations=scale_gradient(pose.rotations, share),
            trans=scale_gradient(pose.trans, share),
            betas_change=scene.betas_change,
        )

    def step(self, shown: list[int], width: float) -> None:
        """One step after a backward pass over images of the frames `shown`, ascending. width: seconds over which frames
        share what images say of them."""
        scene, fps = self.scene, self.scene.motion.fps
        frames = torch.tensor(scene.frames, device=scene.device)
        at = torch.tensor([self._row[frame] for frame in shown], device=scene.device)
        rows, kernel = shared_frames(frames / fps, at, width)
        own = {p: leaf.grad for p, leaf in self.leaves.items() if leaf.grad is not None}
        self.optimizer.step(frames[rows], kernel, own)
        scene.moved(frames[rows].tolist())
