"""A training from its configuration to its last stage (paper, section 4.3)."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path
from typing import Any

import torch

from gavatar_runtime.cpus import usable_cpus
from gavatar_runtime.notes import Note
from gavatar_runtime.progress import shown

from ..assemble import AvatarBuild, build_configured, build_rasterizer, capture_on_body, choose_device
from ..capture.capture import Capture, View
from ..capture.meeting import apart
from ..capture.opening import open_capture
from ..config import AUTO, TrainConfig
from ..losses import LossComposer
from ..storage import load_tensors, write_motion
from .choosing import Chooser
from .footage import FootageSource
from .memory import keep_freed_memory
from .motion_table import MotionTable
from .plan import stage_plans
from .pose_learning import PoseLearner
from .precision import mixed
from .record import Record
from .remedies.exposure import Exposure
from .remedies.placed_evidence import PlacedEvidence
from .remedies.shape import new_shape
from .scene import Scene
from .stage import CHECKPOINT, Stage


class Trainer:
    """Trains one avatar in one run directory; a killed run continues from its last checkpoint to the same result.

    directory holds: config.yaml, checkpoint.pt (the state to resume from), stage1.pt and stage2.pt (the avatar after
    each stage), motion.npz (refined motion), metrics.json, previews/,
    evidence.png (the body coloured by what the views show of it).
    """

    def __init__(self, config: TrainConfig, directory: Path):
        keep_freed_memory()
        self.config, self.directory = config, Path(directory)
        torch.set_num_threads(config.threads or min(torch.get_num_threads(), usable_cpus()))
        device = choose_device(config.device)
        capture = open_capture(config.capture, config.capture_format)
        capture.check()
        views = capture.views(config.train_split)
        self.losses = LossComposer(config.losses)
        built = build_configured(config, capture)
        self.capture = capture_on_body(capture, built.body.data)
        for sentence in (sides_as_numbers(built), apart(self.capture, built.body.data, views)):
            if sentence:
                warnings.warn(sentence, Note)
        built.avatar.to(device).mixed_precision = mixed(config.precision, config.decoder, device)
        self.scene = training_scene(config, built, self.capture, views)
        self.plans = stage_plans(config, dynamic=built.avatar.encoder is not None)
        self.poses = PoseLearner(self.scene, config.motion)
        self.record = Record(self.directory, config.tensorboard)

    def run(self) -> None:
        """Train all stages from wherever the directory's checkpoint stands."""
        path = self.directory / CHECKPOINT
        state = load_tensors(path) if path.exists() else None
        if state is not None:
            self._restore(state)
            if where := self._continuation(state["stage"], state["step"]):
                warnings.warn(where, Note)
        if self.config.mask_matte == AUTO:
            Chooser(self.scene, self.record).masks()
        for plan in self.plans:
            if state is not None and plan.number < state["stage"]:
                continue
            resume = state if state is not None and state["stage"] == plan.number else None
            self.stage(plan.number).run(resume)
            state = None
        write_motion(self.directory / "motion.npz", self.scene.motion.motion())
        avatar = self.scene.avatar
        self.record.write(len(avatar.surface.points) if avatar.placed else None, finished=True)

    def stage(self, number: int) -> Stage:
        """A stage, ready to run."""
        plan = next(plan for plan in self.plans if plan.number == number)
        return Stage(plan, self.scene, self.losses, self.poses, self.record, self.config.progress)

    def _continuation(self, number: int, step: int) -> str:
        """Where a checkpoint lets the run go on, in a sentence; '' if nothing is left to do."""
        left = {plan.number: plan.stage.steps for plan in self.plans if plan.number >= number}
        if step >= left.get(number, 0):
            left.pop(number, None)
        if not any(left.values()):
            return ""
        where = f"step {step} of {left[number]} in stage {number}" if number in left else f"the end of stage {number}"
        return f"{self.directory} goes on from its checkpoint, at {where}"

    def _restore(self, state: dict[str, Any]) -> None:
        """The avatar and all around it as a checkpoint has them."""
        scene = self.scene
        scene.avatar.load_state_dict(state["avatar"])
        scene.motion.load_state_dict(state["motion"])
        if "exposure" in state:
            scene.exposure = scene.exposure or Exposure(len(scene.views)).to(scene.device)
            scene.exposure.load_state_dict(state["exposure"])
        if "shape" in state:
            scene.shape = scene.shape or new_shape(scene.built).to(scene.device)
            scene.shape.load_state_dict(state["shape"])
            if state["stage"] > 1:
                scene.settle_shape()
        if "evidence" in state:
            scene.evidence = PlacedEvidence.from_state(state["evidence"], str(self.directory / CHECKPOINT))
        self.record.load_state(state)


def sides_as_numbers(built: AvatarBuild) -> str:
    """What the levels that name a side of the atlas mean where points are no texels, in a sentence; '' without such."""
    if built.policy_traits.texels:
        return ""
    sides = sorted({level.uv for level in built.levels if level.uv is not None})
    meant = ", ".join(f"uv: {side} for gaussians: {len(built.atlas(side))}" for side in sides)
    return meant and f"levels name sides of the atlas, which stand for the number of its texels: {meant}"


def training_scene(config: TrainConfig, built: AvatarBuild, capture: Capture, views: list[View]) -> Scene:
    """The scene of a training at its start, on the avatar's device. capture: on the avatar's body."""
    avatar, data, options = built.avatar, built.body.data, config.motion
    device, shaped = avatar.features.device, options.betas is True and options.enabled
    footage = FootageSource(
        capture,
        views,
        crop=config.crop,
        mask_matte=0.0 if config.mask_matte == AUTO else config.mask_matte,
        bar=lambda items: shown(items, "reading images", "image", show=config.progress),
    )
    return Scene(
        built,
        build_rasterizer(config.rasterizer, avatar),
        footage,
        MotionTable(capture.motion, data.num_joints, options.joints).to(device),
        Exposure(len(views)).to(device) if config.exposure is True else None,
        new_shape(built).to(device) if shaped else None,
    )


def resolved(config: TrainConfig) -> dict[str, Any]:
    """The configuration as plain values, without what does not change the result (for comparison on resume)."""
    plain = dataclasses.asdict(config)
    for key in ("out", "overwrite", "progress", "threads", "tensorboard", "preview_every", "checkpoint_every"):
        plain.pop(key)
    return plain
