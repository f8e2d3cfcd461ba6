"""The two stages of the paper (section 4.3): appearance with motion, then pose-dependent dynamics."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from gavatar_runtime.errors import UserError

from ..assemble import AvatarBuild, build_avatar, build_rasterizer, capture_on_body, choose_device
from ..capture.capture import View
from ..capture.opening import open_capture
from ..config import TrainConfig
from ..losses import LossComposer
from ..storage import load_tensors, write_json, write_motion
from .footage import Footage, footage, load_full
from .memory import keep_freed_memory
from .motion_table import MotionTable
from .precision import mixed
from .remedies.exposure import Exposure
from .remedies.shape import Shape
from .stage import CHECKPOINT, Stage


class Trainer:
    """Trains one avatar in one run directory; a killed run continues from its last checkpoint to the same result.

    directory holds: config.yaml, checkpoint.pt (the state to resume from), stage1.pt and stage2.pt (the avatar after
    each stage), motion.npz (refined motion), metrics.json, previews/.
    """

    def __init__(self, config: TrainConfig, directory: Path):
        keep_freed_memory()
        self.config, self.directory = config, Path(directory)
        if config.threads:
            torch.set_num_threads(config.threads)
        self.device = choose_device(config.device)
        self.capture = open_capture(config.capture, config.capture_format)
        self.capture.check()
        self.views: list[View] = self.capture.views(config.train_split)
        self.losses = LossComposer(config.losses)
        self.built: AvatarBuild = build_avatar(
            config.body, config.encoder, config.decoder, config.avatar, self.capture, config.seed
        )
        self.capture = capture_on_body(self.capture, self.built.body.data)
        self.avatar = self.built.avatar.to(self.device)
        self.rasterize = build_rasterizer(config.rasterizer, self.avatar)
        self.avatar.mixed_precision = mixed(config.precision, self.avatar.decoder, self.device)
        self.motion = MotionTable(
            self.capture.motion, self.built.body.data.num_joints, config.motion.joints
        ).to(self.device)  # fmt: skip
        self.exposure = Exposure(len(self.views)).to(self.device) if config.exposure else None
        self.shape: Shape | None = None
        self.shape_settled = False
        if config.motion.betas and config.motion.enabled:
            self.shape = Shape(self.built.betas, self.built.body.data.num_betas).to(self.device)
        self.frames = sorted({view.frame for view in self.views})
        self._frame_row = {frame: row for row, frame in enumerate(self.frames)}
        self.motion_state: dict[str, Any] | None = None  # of the optimiser of the poses, after stage 1
        self._footage: dict[float, Footage] = {}
        self._full: list | None = None
        self._inputs: dict[int, list[Tensor]] = {}
        self.history: list[dict[str, Any]] = []
        self.seconds = {1: 0.0, 2: 0.0}
        self.verdicts: dict[str, Any] = {}
        self._board = _tensorboard(self.directory) if config.tensorboard else None

    def run(self) -> None:
        """Train both stages from wherever the directory's checkpoint stands."""
        state = load_tensors(self.directory / CHECKPOINT) if (self.directory / CHECKPOINT).exists() else None
        if state is not None:
            self.avatar.load_state_dict(state["avatar"])
            self.motion.load_state_dict(state["motion"])
            if self.exposure is not None:
                self.exposure.load_state_dict(state["exposure"])
            if self.shape is not None:
                self.shape.load_state_dict(state["shape"])
                if state["stage"] > 1:
                    self.settle_shape()
            self.history, self.seconds = state["history"], state["seconds"]
            self.verdicts = state.get("verdicts", {})
        for number in self._stages():
            if state is not None and number < state["stage"]:
                continue
            resume = state if state is not None and state["stage"] == number else None
            Stage(self, number).run(resume)
            state = None
        write_motion(self.directory / "motion.npz", self.motion.motion())
        self.write_metrics(finished=True)

    def _stages(self) -> list[int]:
        return [1, 2] if self.avatar.encoder is not None and self.config.stage2.steps else [1]

    def footage_at(self, scale: float) -> Footage:
        """The training images at an image scale, decoded at most once."""
        if scale not in self._footage:
            if self._full is None:
                bar = _bar(self.config.progress, "reading images", unit="image")
                self._full = load_full(self.capture, self.views, bar, self.config.mask_matte)
            self._footage = {
                scale: footage(self.capture, self.views, self._full, scale, self.config.crop, self.config.mask_edge)
            }
        return self._footage[scale]

    def pose_inputs(self, frames: list[int]) -> list[Tensor]:
        """What the encoder looks at of the refined motion, (B, ...) each, without gradient; kept until `moved`."""
        for frame in frames:
            if frame not in self._inputs:
                pose = self.motion.motion(rows=[frame]).poses
                self._inputs[frame] = self.built.encoder_tensors(pose)
        return [torch.cat(values) for values in zip(*(self._inputs[f] for f in frames), strict=True)]

    def moved(self, frames: list[int]) -> None:
        """The poses of these frames are no longer what `pose_inputs` has seen."""
        for frame in frames:
            self._inputs.pop(frame, None)

    def shape_change(self) -> Tensor | None:
        """What the shape is corrected by beyond the body that the avatar stands on, None where that is all."""
        return None if self.shape is None or self.shape_settled else self.shape.change

    def settle_shape(self) -> None:
        """From here on the avatar is the body of the shape as it is corrected now, sampled afresh."""
        betas, self.shape_settled = self.shape.betas, True
        self.built.reshape(betas)
        self.motion.betas = betas.astype(np.float32)
        self._inputs.clear()
        self.verdicts["betas"] = {"estimated": self.shape.estimated.tolist(), "refined": betas.round(4).tolist()}

    def seen(self, rows: list[int], render: Tensor, alpha: Tensor, background: Tensor) -> Tensor:
        """Renders (B, 3, H, W) with the exposures of the training views in `rows`, where those are learnt."""
        if self.exposure is None:
            return render
        return self.exposure(rows, render, alpha, background.to(self.device))

    def write_metrics(self, finished: bool) -> None:
        write_json(
            self.directory / "metrics.json",
            {
                "finished": finished,
                "seconds": {f"stage{k}": round(v, 2) for k, v in self.seconds.items()},
                "gaussians": len(self.avatar.surface.points) if self.avatar.surface is not None else None,
                "verdicts": self.verdicts,
                "history": self.history,
            },
        )

    def log(self, entry: dict[str, Any]) -> None:
        self.history.append(entry)
        if self._board is not None:
            for key, value in entry["losses"].items():
                self._board.add_scalar(f"stage{entry['stage']}/{key}", value, entry["step"])


def _bar(show: bool, title: str, unit: str):
    return lambda items: tqdm(items, desc=title, unit=unit, disable=not show)


def _tensorboard(directory: Path):
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise UserError("tensorboard=true needs the tensorboard package: pip install 'gavatar[tensorboard]'") from None
    return SummaryWriter(str(directory / "tensorboard"))


def resolved(config: TrainConfig) -> dict[str, Any]:
    """The configuration as plain values, without what does not change the result (for comparison on resume)."""
    plain = dataclasses.asdict(config)
    for key in ("out", "overwrite", "progress", "threads", "tensorboard", "preview_every", "checkpoint_every"):
        plain.pop(key)
    return plain
