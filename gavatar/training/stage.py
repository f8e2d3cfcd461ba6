"""One stage of training in progress: its optimisers, its steps, what it leaves behind."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from gavatar_runtime.errors import UserError

from ..config import StageConfig
from ..losses import LossInputs, MotionState
from ..storage import load_tensors, save_tensors, write_image
from .footage import Footage
from .motion_table import RowAdam, scale_gradient, shared_frames
from .preview import as_image, side_by_side
from .remedies.acceptance import dynamics_verdict, held_out_rows, refuse_worse_poses, view_errors
from .remedies.exposure import RATE as EXPOSURE_RATE
from .remedies.facing import facing_texels
from .remedies.filling import fill_unseen
from .remedies.outliers import mend_outliers
from .remedies.shape import Shape
from .schedule import background_at, batch_rows, level_at, lr_factor, sharing_width

if TYPE_CHECKING:
    from .trainer import Trainer

log = logging.getLogger("gavatar.training")

CHECKPOINT = "checkpoint.pt"
STAGE_FILES = {1: "stage1.pt", 2: "stage2.pt"}
REFUSED = "stage2_refused.pt"  # what dynamics=auto found not worth keeping


class Stage:
    """One stage in progress: its optimisers and its loop."""

    def __init__(self, trainer: Trainer, number: int):
        self.trainer, self.number = trainer, number
        self.config: StageConfig = getattr(trainer.config, f"stage{number}")
        avatar, motion = trainer.avatar, trainer.motion
        groups = [{"params": list(avatar.decoder.parameters()), "lr": self.config.lr_decoder}]
        self.learns_features = number == 1 or self.config.lr_features > 0
        if self.learns_features:
            first = [avatar.features, *avatar.smooth.parameters()]
            groups.append({"params": first, "lr": self.config.lr_features})
        if number == 2:
            groups.append({"params": list(avatar.encoder.parameters()), "lr": self.config.lr_encoder})
        self.base_lr = [group["lr"] for group in groups]
        self.optimizer = torch.optim.Adam(groups, fused=True)  # one pass over each parameter
        options = trainer.config.motion
        shares = (1.0, 1.0) if number == 1 else (options.stage2, options.stage2_trans)
        self.moves = options.enabled and max(shares) > 0
        mends = self.moves and number == 1 and options.mend > 0
        self.mend_step = min(round(options.mend * self.config.steps), self.config.steps - 1) if mends else None
        self.motion_lr = (shares[0] * options.lr, shares[1] * options.lr_trans)
        self.motion_optimizer = RowAdam(
            [
                {"params": [motion.rotation_correction], "lr": options.lr},
                {"params": [motion.trans_correction], "lr": options.lr_trans},
            ]
        )
        if trainer.motion_state is not None:
            # a frame is seen a few times in stage 2; begun anew, Adam's first steps are of full length for every joint
            self.motion_optimizer.load_state_dict(trainer.motion_state)
        exposure = [] if trainer.exposure is None else [trainer.exposure.log_gain]
        self.exposure_optimizer = RowAdam(exposure, lr=EXPOSURE_RATE) if exposure and number == 1 else None
        for gain in exposure:
            gain.requires_grad_(number == 1)
        self.shape: Shape | None = trainer.shape if number == 1 else None
        self.shape_optimizer = None
        if self.shape is not None:
            self.shape_optimizer = torch.optim.Adam(self.shape.parameters(), lr=options.lr_betas, betas=(0.9, 0.99))
        avatar.features.requires_grad_(self.learns_features)
        avatar.smooth.requires_grad_(self.learns_features)
        motion.requires_grad_(self.moves)
        self.motion_leaves: dict[torch.nn.Parameter, Tensor] = {}
        self.held_out = held_out_rows(len(trainer.views)) if number == 2 and trainer.config.dynamics == "auto" else []
        self.rows = [row for row in range(len(trainer.views)) if row not in set(self.held_out)]

    def run(self, resume: dict[str, Any] | None) -> None:
        start = 0
        if resume is not None:
            start = resume["step"]
            self.optimizer.load_state_dict(resume["optimizer"])
            for parameter, state in self.optimizer.state.items():  # whatever the layout it was saved in
                for key in ("exp_avg", "exp_avg_sq"):
                    state[key] = torch.empty_like(parameter).copy_(state[key]).detach()
            self.motion_optimizer.load_state_dict(resume["motion_optimizer"])
            if self.exposure_optimizer is not None:
                self.exposure_optimizer.load_state_dict(resume["exposure_optimizer"])
            if self.shape_optimizer is not None:
                self.shape_optimizer.load_state_dict(resume["shape_optimizer"])
        trainer, steps = self.trainer, self.config.steps
        trainer.avatar.train()
        if self.number == 2 and start == 0:
            self._prepare_encoder()
        if self.held_out and "static_errors" not in trainer.verdicts:
            trainer.avatar.sample_at(trainer.built.surface(trainer.config.stage1.levels[-1].uv))
            # of images of the size that this stage is judged by: errors of smaller ones are smaller
            errors = view_errors(trainer, self.held_out, 1, image=self.config.levels[-1].image)
            trainer.verdicts["static_errors"] = errors.tolist()
        bar = tqdm(
            total=steps, initial=start, desc=f"stage {self.number}", unit="step", disable=not trainer.config.progress
        )
        clock = time.perf_counter()
        for step in range(start, steps):
            losses = self._step(step)
            bar.update()
            last = step + 1 == steps
            if step % 10 == 0 or last:
                bar.set_postfix({k: f"{v:.4f}" for k, v in losses.items() if k in ("total", "l1", "ssim")})
                trainer.log({"stage": self.number, "step": step, "losses": {k: float(v) for k, v in losses.items()}})
            if not np.isfinite(losses["total"]):
                rates = f"stage{self.number}.lr_decoder or motion.lr"
                rates += "" if self.shape is None else " or motion.lr_betas"
                raise UserError(
                    f"stage {self.number} diverged at step {step}: the loss is {losses['total']}; lower {rates}"
                )
            if (step + 1) % trainer.config.checkpoint_every == 0 and not last:
                trainer.seconds[self.number] += time.perf_counter() - clock
                clock = time.perf_counter()
                self._save(step + 1)
        bar.close()
        trainer.motion_state = self.motion_optimizer.state_dict()
        trainer.seconds[self.number] += time.perf_counter() - clock
        if start >= steps:  # nothing is left to do, or there never was: no step has placed the points
            trainer.avatar.sample_at(trainer.built.surface(self.config.levels[-1].uv))
        if self.shape is not None:
            trainer.settle_shape()
            trainer.avatar.sample_at(trainer.built.surface(self.config.levels[-1].uv))
        result = self._judged()  # before the guard, which chooses poses by the very views that judge
        if self.moves and trainer.config.motion.guard and start < steps and result != REFUSED:
            name = "frames_kept_as_estimated" + ("" if self.number == 1 else "_stage2")
            trainer.verdicts[name] = refuse_worse_poses(trainer, self.number)
        if self.number == 1 and trainer.config.fill_unseen and start < steps:
            trainer.verdicts["unseen"] = fill_unseen(trainer)
        save_tensors(trainer.directory / result, self._avatar_state())
        self._save(steps)
        if result == REFUSED:  # the avatar is stage 1's, and so are its poses
            trainer.motion.load_state_dict(load_tensors(trainer.directory / STAGE_FILES[1])["motion"])

    def _prepare_encoder(self) -> None:
        trainer, prepare = self.trainer, getattr(self.trainer.avatar.encoder, "prepare", None)
        if prepare is None:
            return
        views = [trainer.views[row] for row in self.rows]
        frames, cameras = [view.frame for view in views], [trainer.capture.camera(view) for view in views]
        surface = trainer.built.surface(trainer.avatar.encoder.map_size)
        seen = facing_texels(surface, trainer.motion.motion(), frames, cameras).to(trainer.device)
        prepare(surface, seen, *trainer.pose_inputs(frames))

    def _judged(self) -> str:
        """The file that this stage's result goes to; with dynamics=auto, not stage2.pt if it does not pay. A stage that
        was judged before keeps its verdict: the guard has chosen poses since, by the views that judge."""
        trainer = self.trainer
        if not self.held_out:
            return STAGE_FILES[self.number]
        if "dynamics" not in trainer.verdicts:
            static, dynamic = np.array(trainer.verdicts["static_errors"]), view_errors(trainer, self.held_out, 2)
            trainer.verdicts["dynamics"] = dynamics_verdict(static, dynamic, trainer.config.dynamics_gain)
        verdict = trainer.verdicts["dynamics"]
        if verdict["kept"]:
            return STAGE_FILES[2]
        log.warning(
            "dynamics are not worth their cost in this capture: %+.2f dB on %d views that stage 2 did not see; "
            "the avatar is the static one of stage 1",
            verdict["gain_db"],
            verdict["views"],
        )
        return REFUSED

    def _avatar_state(self) -> dict[str, Any]:
        trainer = self.trainer
        shape = {} if trainer.shape is None else {"betas": torch.from_numpy(trainer.shape.betas)}
        return shape | {
            "avatar": trainer.avatar.state_dict(),
            "motion": trainer.motion.state_dict(),
            "stage": self.number,
            "uv": self.config.levels[-1].uv,
        }

    def _save(self, step: int) -> None:
        trainer = self.trainer
        trainer.write_metrics(finished=False)
        asked = {
            "exposure": trainer.exposure,
            "exposure_optimizer": self.exposure_optimizer,
            "shape": trainer.shape,
            "shape_optimizer": self.shape_optimizer,
        }
        save_tensors(
            trainer.directory / CHECKPOINT,
            self._avatar_state()
            | {name: part.state_dict() for name, part in asked.items() if part is not None}
            | {
                "step": step,
                "optimizer": self.optimizer.state_dict(),
                "motion_optimizer": self.motion_optimizer.state_dict(),
                "history": trainer.history,
                "seconds": trainer.seconds,
                "verdicts": trainer.verdicts,
            },
        )

    def _prepare(self, step: int) -> tuple[Footage, float]:
        trainer, level = self.trainer, level_at(self.config, step)
        surface = trainer.built.surface(level.uv)
        if trainer.avatar.surface is not surface:
            trainer.avatar.sample_at(surface)
        factor = lr_factor(self.config, step)
        for group, lr in zip(self.optimizer.param_groups, self.base_lr, strict=True):
            group["lr"] = lr * factor
        for group, lr in zip(self.motion_optimizer.param_groups, self.motion_lr, strict=True):
            group["lr"] = lr * factor
        if self.shape_optimizer is not None:
            self.shape_optimizer.param_groups[0]["lr"] = trainer.config.motion.lr_betas * factor
        on_step = getattr(trainer.avatar.decoder, "on_step", None)
        if on_step is not None and self.number == 1:
            on_step(step)
        return trainer.footage_at(level.image), step / max(1, self.config.steps)

    def _step(self, step: int) -> dict[str, float]:
        trainer, config = self.trainer, self.trainer.config
        data, progress = self._prepare(step)
        if step == self.mend_step:
            self._mend(level_at(self.config, step).image)
        drawn = batch_rows(config.seed + self.number, len(self.rows), self.config.batch, step)
        rows = [self.rows[r] for r in drawn]
        frames = [data.views[r].frame for r in rows]
        background = background_at(config.background, config.seed + self.number, step)
        target, mask = data.batch(rows, background, trainer.device)
        inputs = self._render(rows, frames, data, background, target, mask, progress)
        total, values = trainer.losses(inputs)
        self.optimizer.zero_grad(set_to_none=True)
        self.motion_optimizer.zero_grad(set_to_none=True)
        if self.exposure_optimizer is not None:
            self.exposure_optimizer.zero_grad(set_to_none=True)
        if self.shape_optimizer is not None:
            self.shape_optimizer.zero_grad(set_to_none=True)
        total.backward()
        self.optimizer.step()
        if self._moves_at(progress):
            self._step_motion(sorted(set(frames)), progress)
            if self.shape_optimizer is not None:
                self.shape_optimizer.step()
        if self.exposure_optimizer is not None:
            self.exposure_optimizer.step(torch.tensor(rows, device=trainer.device))
        if step % config.preview_every == 0 or step + 1 == self.config.steps:
            picture = side_by_side(as_image(inputs.target[0]), as_image(inputs.render[0]))
            write_image(trainer.directory / "previews" / f"stage{self.number}_{step:06d}.png", picture)
        return {"total": float(total.detach()), **values}

    def _mend(self, image: float) -> None:
        mended = mend_outliers(self.trainer, image)
        self.motion_optimizer.forget(mended)
        self.trainer.moved(mended)
        self.trainer.verdicts["frames_mended"] = mended

    def _step_motion(self, shown: list[int], progress: float) -> None:
        trainer, options = self.trainer, self.trainer.config.motion
        frames = torch.tensor(trainer.frames, device=trainer.device)
        at = torch.tensor([trainer._frame_row[frame] for frame in shown], device=trainer.device)
        span = (trainer.frames[-1] - trainer.frames[0]) / trainer.motion.fps
        width = sharing_width(options, progress if self.number == 1 else 1.0, span)
        rows, kernel = shared_frames(frames / trainer.motion.fps, at, width)
        own = {p: leaf.grad for p, leaf in self.motion_leaves.items() if leaf.grad is not None}
        self.motion_optimizer.step(frames[rows], kernel, own)
        trainer.moved(frames[rows].tolist())

    def _render(self, rows, frames, data: Footage, background, target, mask, progress: float) -> LossInputs:
        trainer, avatar = self.trainer, self.trainer.avatar
        pose_features = None
        if self.number == 2:
            pose_features = avatar.encode(*trainer.pose_inputs(frames))
        attributes = avatar.attributes(pose_features)
        images, alphas = [], []
        expression, change = trainer.motion.expression(frames), trainer.shape_change()
        posed = avatar.pose(attributes, *trainer.motion(frames), expression, change)
        for row, gaussians in zip(rows, posed, strict=True):
            rendering = trainer.rasterize(gaussians, data.cameras[row], background.to(trainer.device))
            images.append(rendering.color.permute(2, 0, 1))
            alphas.append(rendering.alpha)
        render, alpha = trainer.seen(rows, torch.stack(images), torch.stack(alphas), background), torch.stack(alphas)
        target, render, mask, alpha = data.believed(rows, target, mask, render, alpha)
        return LossInputs(
            render=render,
            target=target,
            alpha=alpha,
            mask=mask,
            features=avatar.features if self.learns_features else None,
            pose_features=pose_features,
            offsets=attributes.offsets,
            scales=attributes.scales,
            progress=progress,
            motion=self._motion_state(len(set(frames))) if self._moves_at(progress) else None,
        )

    def _moves_at(self, progress: float) -> bool:
        options = self.trainer.config.motion
        return self.moves and (self.number == 2 or options.start <= progress <= options.end)

    def _motion_state(self, shown: int) -> MotionState:
        """The motion of every training frame for the losses, read from leaves of its own: what images say is shared
        between neighbours, what the motion's terms say must not be, for they tell frames from their neighbours. Only
        `shown` frames' images are in a step and share the image terms among themselves; the motion terms are weighed
        alike, or their weight would hang on the capture's length and, with it, on its frame rate."""
        table, frames = self.trainer.motion, self.trainer.frames
        self.motion_leaves = {
            p: p.detach().requires_grad_() for p in (table.rotation_correction, table.trans_correction)
        }
        rotations, trans = table(frames, *self.motion_leaves.values())
        share = len(frames) / shown
        initial_rotations, initial_trans = table.initial_rotations[frames], table.initial_trans[frames]
        mended = [self.trainer._frame_row[frame] for frame in self.trainer.verdicts.get("frames_mended", [])]
        if mended:  # their estimate was found wrong: it must not draw them back
            initial_rotations[mended], initial_trans[mended] = rotations[mended].detach(), trans[mended].detach()
        return MotionState(
            rotations=scale_gradient(rotations, share),
            rotations_initial=initial_rotations,
            trans=scale_gradient(trans, share),
            trans_initial=initial_trans,
            frame_times=torch.tensor(frames, device=trans.device, dtype=trans.dtype) / table.fps,
            betas_change=self.trainer.shape_change(),
        )
