"""How good a run is: images against the footage, joints against the truth where the capture has it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.progress import shown
from gavatar_runtime.values.motion import Motion

from ..assemble import build_rasterizer
from ..attributes import Attributes
from ..capture.capture import Capture, View
from ..images.image_quality import psnr, ssim
from ..images.metrics import perceptual_metric
from ..training.footage import FootageSource
from ..training.motion_table import MotionTable
from ..training.posing import attributes_in
from ..training.run import Run
from ..training.scene import Scene
from .joint_errors import motion_errors, part_errors
from .pose_fitting import fit_poses
from .result import Evaluation, SplitScore, ViewScore


class Evaluator:
    """Renders a run's avatar for views of its capture.

    perceptual: a function of two (1, 3, H, W) images, or None to leave that column out. device: where the run's avatar
    is moved to, rendered and scored.
    """

    def __init__(
        self,
        run: Run,
        perceptual: Callable[[Tensor, Tensor], Tensor] | None = None,
        progress: bool = True,
        device: str | torch.device = "cpu",
    ):
        self.run, self.perceptual, self.progress, self.device = run, perceptual, progress, torch.device(device)
        run.avatar.to(self.device)
        self.rasterize = build_rasterizer(run.config.rasterizer, run.avatar)
        self._static: Attributes | None = None

    def scene(self, views: Sequence[View], motion: Motion) -> Scene:
        """The avatar in the poses of `motion`, and the footage of `views` as it would be trained on."""
        run, config = self.run, self.run.config
        footage = FootageSource(run.capture, list(views), crop=config.crop, mask_matte=config.mask_matte)
        table = MotionTable(motion, run.built.body.data.num_joints, config.motion.joints).to(self.device)
        return Scene(run.built, self.rasterize, footage, table)

    @torch.no_grad()
    def render(self, view: View, motion: Motion) -> np.ndarray:
        """(H, W, 3) float32 image of the avatar on white in the pose that `motion` has at the view's frame."""
        return self._image(self.scene([view], motion), view, motion)[0].permute(1, 2, 0).cpu().numpy()

    @torch.no_grad()
    def score(self, split: str, poses: str, views: Sequence[View], motion: Motion) -> SplitScore:
        """Scores of `views` with the poses of `motion`, and its joint error over their frames where truth exists."""
        run, scene, scores = self.run, self.scene(views, motion), []
        for view in shown(views, f"{split}, {poses} poses", "view", show=self.progress):
            color, alpha = run.capture.load(view)
            target = torch.from_numpy(color + (1 - alpha[..., None])).permute(2, 0, 1)[None].to(self.device)
            image = self._image(scene, view, motion).clamp(0, 1)
            distance = None if self.perceptual is None else float(self.perceptual(image, target))
            scores.append(ViewScore(view, float(psnr(image, target)), float(ssim(image, target)), distance))
        result = SplitScore(split, poses, scores)
        if run.capture.truth is not None:
            result.mpjpe_mm, result.pa_mpjpe_mm = motion_errors(run.built, motion, run.capture.truth, scene.frames)
            result.parts = part_errors(run.built, motion, run.capture.truth, scene.frames)
        return result

    def fit(self, views: Sequence[View], steps: int = 60, image_scale: float = 1.0) -> Motion:
        """The capture's motion with the frames of `views` fitted to their images, avatar frozen (`fit_poses`). Pose
        features are those of the estimated pose while fitting."""
        config, estimated = self.run.config, self.run.capture.motion
        scene = self.scene(views, estimated)
        attributes = {frame: self._attributes(estimated, frame) for frame in scene.frames}
        return fit_poses(
            scene, attributes, config.losses, config.motion, steps, scale=image_scale, progress=self.progress
        )

    def _image(self, scene: Scene, view: View, motion: Motion) -> Tensor:
        """(1, 3, H, W) the whole frame as a player shows it. scene: in the poses of `motion`."""
        attributes, camera = self._attributes(motion, view.frame), self.run.capture.camera(view)
        image, _ = scene.draw(attributes, scene.motion([view.frame]), [camera], pixel=self.run.pixel)
        return image.contiguous(memory_format=torch.channels_last)  # in memory as footage is

    def _attributes(self, motion: Motion, frame: int) -> Attributes:
        """As decoded in the pose of a frame; those of an avatar without encoder are decoded once."""
        if self.run.avatar.encoder is not None:
            return attributes_in(self.run, motion, frame)
        if self._static is None:
            self._static = attributes_in(self.run, motion, frame)
        return self._static


def evaluation_plan(
    capture: Capture, splits: Sequence[str] | None, fit: bool, train_split: str
) -> list[tuple[str, str, list[View]]]:
    """(split, poses, views) rows worth having: training views with refined poses; held-out ones with true poses where
    the capture has them, else the estimated ones, and fitted; other cameras with true poses or, for trained frames,
    refined ones. train_split: that of the training views."""
    trained = {view.frame for view in capture.views(train_split)}
    plan = []
    for split in splits or [s for s, views in capture.splits.items() if views]:
        views = capture.views(split)
        if split == train_split:
            plan.append((split, "refined", views))
            continue
        plan.append((split, "true" if capture.truth is not None else "estimated", views))
        seen = [view for view in views if view.frame in trained]
        if seen:
            plan.append((split, "refined", seen))
        elif fit:
            plan.append((split, "fitted", views))
    return plan


def evaluate(
    run: Run,
    splits: Sequence[str] | None = None,
    fit_steps: int = 60,
    perceptual: bool = True,
    progress: bool = True,
    device: str | torch.device = "cpu",
) -> Evaluation:
    """Score every split of the run's capture (or the named ones). fit_steps 0 leaves out rows with fitted poses."""
    metric, name = perceptual_metric() if perceptual else (None, None)
    evaluator = Evaluator(run, metric, progress, device)
    capture = run.capture
    sources = {"refined": run.motion.motion(), "estimated": capture.motion, "true": capture.truth}
    rows, pictures = [], []
    for split, poses, views in evaluation_plan(capture, splits, fit_steps > 0, run.config.train_split):
        motion: Any = evaluator.fit(views, fit_steps) if poses == "fitted" else sources[poses]
        rows.append(evaluator.score(split, poses, views, motion))
        worst = rows[-1].worst.view
        color, alpha = capture.load(worst)
        pictures.append((color + (1 - alpha[..., None]), evaluator.render(worst, motion)))
    result = Evaluation(run, rows, pictures, name)
    if capture.truth is not None:
        frames = sorted({view.frame for view in capture.views(run.config.train_split)})
        result.estimated_mpjpe_mm = motion_errors(run.built, capture.motion, capture.truth, frames)
        result.estimated_parts = part_errors(run.built, capture.motion, capture.truth, frames)
    return result
