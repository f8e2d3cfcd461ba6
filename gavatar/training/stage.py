"""One stage of training in progress: its optimisers, its steps, what it leaves behind."""

from __future__ import annotations

import logging
import time
from typing import Any

import numpy as np
import torch

from gavatar_runtime.errors import UserError
from gavatar_runtime.progress import Progress

from ..attributes import Attributes
from ..losses import LossComposer, LossInputs
from ..registry import LOSSES, LossTraits
from ..storage import load_tensors, save_tensors
from .choosing import Chooser
from .motion_table import RowAdam
from .newness import draw_shares, newness, view_poses
from .plan import Plan
from .pose_learning import PoseLearner
from .record import Record
from .remedies.acceptance import dynamics_verdict, refuse_worse_poses
from .remedies.coarseness import Unevenness, fine_rms
from .remedies.evidence import evidence_of
from .remedies.exposure import RATE as EXPOSURE_RATE
from .remedies.facing import facing_texels
from .remedies.judging import colours_beyond, look
from .remedies.left_out import left_out_rows
from .remedies.outliers import judging_scale, mend_outliers
from .remedies.prior import SURE, Prior, fill
from .scene import Scene
from .schedule import background_at, batch_rows, last_level_start, level_at, lr_factor
from .verdicts import FillingVerdict, Look, ResidualVerdict

log = logging.getLogger("gavatar.training")

CHECKPOINT = "checkpoint.pt"
STAGE_FILES = {1: "stage1.pt", 2: "stage2.pt"}
REFUSED = "stage2_refused.pt"  # what dynamics=auto found not worth keeping


class Stage:
    """Carries out one plan on a scene.

    optimizers: by the name under which the checkpoint keeps them. rows: of the views that the stage learns from.
    learning: of those that the pose encoder learns from; left_out: of those that judge it.
    """

    def __init__(
        self, plan: Plan, scene: Scene, losses: LossComposer, poses: PoseLearner, record: Record, progress: bool = False
    ):
        self.plan, self.scene, self.losses, self.poses, self.record = plan, scene, losses, poses, record
        self.chooser = Chooser(scene, record)
        self.progress = progress
        self.prior: Prior | None = None  # what is held where little was seen, once it is known
        views = range(len(scene.views))
        places = view_poses(scene)
        self.new = newness(places)
        self.left_out = left_out_rows(places, scene.frames_of(views)) if plan.leaves_out else []
        self.learning = [row for row in views if row not in set(self.left_out)]
        self.rows = self.learning if plan.dynamic else list(views)
        self._uneven = Unevenness()
        self.shares = draw_shares(self.new[self.rows]) if plan.draws_new and plan.dynamic else None
        self.optimizers, self._rates = self._make_optimizers()
        scene.avatar.decoder.requires_grad_(plan.learns_decoder)
        scene.avatar.features.requires_grad_(plan.learns_features)
        scene.avatar.smooth.requires_grad_(plan.learns_features)
        scene.motion.requires_grad_(plan.poses_move)
        if scene.exposure is not None:
            scene.exposure.requires_grad_(self.learns_exposure)

    @property
    def learns_exposure(self) -> bool:
        """Whether gains are learnt here: asked for, or found to be needed."""
        return self.scene.exposure is not None and (self.plan.learns_exposure or self.plan.exposure_step is not None)

    @property
    def learns_shape(self) -> bool:
        """Whether the shape is learnt here: asked for, or found to be needed."""
        return self.scene.shape is not None and (self.plan.learns_shape or self.plan.shape_step is not None)

    def _make_optimizers(self) -> tuple[dict[str, torch.optim.Optimizer], dict[str, list[float]]]:
        """The optimisers, and the rates that the schedule multiplies, by parameter group."""
        plan, avatar = self.plan, self.scene.avatar
        groups: list[dict[str, Any]] = []
        if plan.learns_decoder:
            groups.append({"params": list(avatar.decoder.parameters()), "lr": plan.stage.lr_decoder})
        if plan.learns_features:
            first = [avatar.features, *avatar.smooth.parameters()]
            groups.append({"params": first, "lr": plan.stage.lr_features})
        if plan.dynamic:
            groups.append({"params": list(avatar.encoder.parameters()), "lr": plan.stage.lr_encoder})
        rates: dict[str, list[float]] = {
            "optimizer": [group["lr"] for group in groups],
            "motion_optimizer": list(plan.pose_rates),
        }
        optimizers: dict[str, torch.optim.Optimizer] = {
            "optimizer": torch.optim.Adam(groups, fused=True),  # one pass over each parameter
            "motion_optimizer": self.poses.optimizer,
        }
        if self.learns_exposure:
            optimizers["exposure_optimizer"] = self._exposure_optimizer()
        if self.learns_shape:
            optimizers["shape_optimizer"] = self._shape_optimizer()
            rates["shape_optimizer"] = [plan.motion.lr_betas]
        return optimizers, rates

    def _exposure_optimizer(self) -> torch.optim.Optimizer:
        assert self.scene.exposure is not None
        return RowAdam([self.scene.exposure.log_gain], lr=EXPOSURE_RATE)

    def _shape_optimizer(self) -> torch.optim.Optimizer:
        assert self.scene.shape is not None
        return torch.optim.Adam(self.scene.shape.parameters(), lr=self.plan.motion.lr_betas, betas=(0.9, 0.99))

    @property
    def judged(self) -> bool:
        """Whether what the stage learns is kept only if it pays, by views that there are."""
        return self.plan.least_gain is not None and len(self.left_out) > 0

    # --- the run of the stage -----------------------------------------------------------------------------------------
    def run(self, resume: dict[str, Any] | None) -> None:
        """All steps, or those that a checkpoint leaves to do, and the remedies after them."""
        scene, steps = self.scene, self.plan.stage.steps
        start = 0 if resume is None else self._resume(resume)
        scene.avatar.train()
        if self.plan.waits and steps:
            first = self.plan.stage.levels[0]
            scene.place(first)
            self.plan = self.chooser.window(self.plan, first.image)
        if self.judged and self.record.verdicts.static_look is None:
            scene.place(self.plan.static_level)
            # in images of the size that this stage is judged by: errors of smaller ones are smaller
            self.record.verdicts.static_look = self._look(dynamic=False)
        self._run_steps(start)
        if start >= steps:  # nothing is left to do, or there never was: no step has placed the points
            scene.place(self.plan.stage.levels[-1])
        if self.learns_shape:
            self.record.verdicts.betas = scene.settle_shape()
            scene.place(self.plan.stage.levels[-1])
        result = self._judged()
        scene.place(self.plan.stage.levels[-1])
        self._finish(result, trained=start < steps)

    def _resume(self, state: dict[str, Any]) -> int:
        """Go on from a checkpoint of this stage; the step that it stands at."""
        for name, optimizer in self.optimizers.items():
            optimizer.load_state_dict(state[name])
        for parameter, moments in self.optimizers["optimizer"].state.items():  # whatever the layout it was saved in
            for key in ("exp_avg", "exp_avg_sq"):
                moments[key] = torch.empty_like(parameter).copy_(moments[key]).detach()
        if "prior" in state:
            self.prior = Prior(**state["prior"])
        return state["step"]

    def _prepare_encoder(self) -> None:
        scene, encoder = self.scene, self.scene.avatar.encoder
        if not scene.avatar.encoder_traits.prepares:
            return
        rows = self.learning
        frames = scene.frames_of(rows)
        cameras = [scene.footage.capture.camera(scene.views[row]) for row in rows]
        surface = scene.built.atlas(encoder.map_size)
        seen = facing_texels(surface, scene.motion.motion(), frames, cameras).to(scene.device)
        seen = seen * self.new[rows].to(seen.device, torch.float32)[:, None, None]
        encoder.prepare(surface, seen, *scene.encoder_inputs(frames))

    def _run_steps(self, start: int) -> None:
        plan, record, steps = self.plan, self.record, self.plan.stage.steps
        clock = time.perf_counter()
        title = f"stage {plan.number}"
        with Progress(title, steps, "step", done=start, show=self.progress, lasting=True) as bar:
            for step in range(start, steps):
                if self._lost(step):
                    break
                losses = self.step(step)
                last = step + 1 == steps
                told: dict[str, Any] = {}
                if step % 10 == 0 or last:
                    told = {"loss" if k == "total" else k: v for k, v in losses.items() if k == "total" or _in_bar(k)}
                    record.log(plan.number, step, {k: float(v) for k, v in losses.items()})
                bar.advance(**told)
                if not np.isfinite(losses["total"]):
                    self._diverged(step, losses["total"])
                due = (step + 1) % plan.save_every == 0
                if due or last:
                    self._check_learned(step)
                if due and not last:
                    record.seconds[plan.number] += time.perf_counter() - clock
                    clock = time.perf_counter()
                    self.save(step + 1)
        record.seconds[plan.number] += time.perf_counter() - clock

    def _check_learned(self, step: int) -> None:
        """No checkpoint and no avatar of numbers that are none: a gradient of NaN shows in the loss one step later."""
        groups = [group for optimizer in self.optimizers.values() for group in optimizer.param_groups]
        if not all(torch.isfinite(p).all() for group in groups for p in group["params"]):
            self._diverged(step, float("nan"))

    def _diverged(self, step: int, loss: float) -> None:
        number, rates = self.plan.number, f"stage{self.plan.number}.lr_decoder or motion.lr"
        rates += " or motion.lr_betas" if self.learns_shape else ""
        raise UserError(f"stage {number} diverged at step {step}: the loss is {loss}; lower {rates}")

    # --- a step -------------------------------------------------------------------------------------------------------
    def step(self, step: int) -> dict[str, float]:
        """One optimiser step; the total and each loss of it."""
        plan, progress = self.plan, step / max(1, self.plan.stage.steps)
        image = self._prepare(step)
        if step == plan.exposure_step and self.chooser.exposure(judging_scale(self.scene, image)):
            self.optimizers["exposure_optimizer"] = self._exposure_optimizer()
        if step == plan.shape_step and self.chooser.shape(judging_scale(self.scene, image)):
            self.optimizers["shape_optimizer"] = self._shape_optimizer()
            self._rates["shape_optimizer"] = [plan.motion.lr_betas]
        if plan.dynamic and step == 0:
            self._prepare_encoder()
        if step == plan.mend_step:
            self._mend(image)
        if step == plan.prior_step:
            self._fill(image)
        rows = [self.rows[r] for r in batch_rows(plan.seed, len(self.rows), plan.stage.batch, step, self.shares)]
        inputs, attributes = self._draw(rows, image, background_at(plan.background, plan.seed, step), step)
        total, values = self.losses(inputs)
        if self.prior is not None:
            total = total + self.prior.loss(self.scene.avatar, attributes)
        for optimizer in self.optimizers.values():
            optimizer.zero_grad(set_to_none=True)
        total.backward()
        self._update(rows, progress)
        if step % plan.preview_every == 0 or step + 1 == plan.stage.steps:
            self.record.preview(plan.number, step, inputs.target[0], inputs.render[0], plan.stage.steps)
        return {"total": float(total.detach()), **values}

    def _prepare(self, step: int) -> float:
        """Points and rates for a step; the scale of its images."""
        level, factor = level_at(self.plan.stage, step), lr_factor(self.plan.stage, step)
        self.scene.place(level)
        for name, rates in self._rates.items():
            for group, rate in zip(self.optimizers[name].param_groups, rates, strict=True):
                group["lr"] = rate * factor
        if self.scene.avatar.decoder_traits.counts_steps and not self.plan.dynamic:
            self.scene.avatar.decoder.on_step(step)
        return level.image

    def _mend(self, image: float) -> None:
        self.chooser.mended(mend_outliers(self.scene, image))
        self.poses.optimizer.forget(self.record.verdicts.frames_mended or [])

    def _fill(self, image: float) -> None:
        scene = self.scene
        if not self.plan.dynamic:
            self.chooser.floor(image)
        scene.evidence = evidence_of(scene, image)
        self.prior = fill(scene.avatar, scene.evidence.evidence, scene.built.head, fit=self.plan.learns_features)
        sure = scene.evidence.evidence.confidence
        filled = 0 if self.prior is None else int((sure < SURE).sum())
        self.chooser.filled(FillingVerdict(points=int((sure < 0.5).sum()), of=len(sure), filled=filled))
        self.record.evidence(scene)

    def _draw(
        self, rows: list[int], image: float, background: torch.Tensor, step: int
    ) -> tuple[LossInputs, Attributes]:
        """The views in `rows` and what the losses look at beside them, and what was decoded for them."""
        scene, plan, frames = self.scene, self.plan, self.scene.frames_of(rows)
        progress = step / max(1, plan.stage.steps)
        pose_features = scene.pose_features(frames) if plan.dynamic else None
        attributes = scene.avatar.attributes(pose_features)
        seen = scene.compare(rows, image, attributes, background=background)
        motion, learns = None, plan.learns_decoder or plan.learns_features
        if plan.poses_move_at(progress):
            motion = self.poses.state(len(set(frames)), self.record.verdicts.frames_mended or [])
        inputs = LossInputs(
            render=seen.render,
            target=seen.target,
            alpha=seen.alpha,
            mask=seen.mask,
            features=scene.avatar.features if plan.learns_features else None,
            pose_features=pose_features,
            pose_detail=None if pose_features is None else self._uneven.with_pose(scene.avatar, attributes, learns),
            to_neighbours=self._uneven.between_neighbours(scene.avatar, attributes, step) if learns else None,
            offsets=attributes.offsets,
            scales=attributes.scales,
            progress=progress,
            motion=motion,
        )
        return inputs, attributes

    def _update(self, rows: list[int], progress: float) -> None:
        plan, optimizers = self.plan, self.optimizers
        optimizers["optimizer"].step()
        if plan.poses_move_at(progress):
            shown = sorted(set(self.scene.frames_of(rows)))
            self.poses.step(shown, plan.sharing(progress, self.poses.span))
            if self.learns_shape:
                optimizers["shape_optimizer"].step()
        if self.learns_exposure:
            exposure: Any = optimizers["exposure_optimizer"]  # a `RowAdam`
            exposure.step(torch.tensor(rows, device=self.scene.device))

    # --- the end ------------------------------------------------------------------------------------------------------
    def _judged(self) -> str:
        """The file that this stage's result goes to; with dynamics=auto, not stage2.pt if it does not pay. A stage that
        was judged before keeps its verdict: the guard has chosen poses since, by the views that judge."""
        plan, verdicts, scene = self.plan, self.record.verdicts, self.scene
        if plan.dynamic and verdicts.residual is None:
            fine, beyond = fine_rms(scene, self.learning), colours_beyond(scene, self.learning)
            verdicts.residual = ResidualVerdict(round(fine, 5), round(beyond, 5))
            if self.judged and verdicts.dynamics is None:
                assert plan.least_gain is not None  # else no view is left out
                assert verdicts.static_look is not None
                dynamic = self._look(dynamic=True)
                verdicts.dynamics = dynamics_verdict(verdicts.static_look, dynamic, plan.least_gain)
        if verdicts.dynamics is None or not plan.dynamic:
            return STAGE_FILES[plan.number]
        log.warning(verdicts.dynamics.sentence())
        return STAGE_FILES[plan.number] if verdicts.dynamics.kept else REFUSED

    def _lost(self, step: int) -> bool:
        """Whether dynamics lose, before the last level begins, on the views that judge them: no finer level has mended
        that, and it is the most costly one. Their verdict is that of the level before."""
        plan, verdicts = self.plan, self.record.verdicts
        if not (plan.dynamic and self.judged and step == last_level_start(plan.stage) > 0):
            return False
        level = plan.stage.levels[-2]
        self.scene.place(level)
        static, dynamic = (self._look(dynamic, level.image) for dynamic in (False, True))
        assert plan.least_gain is not None  # else no view is left out
        verdict = dynamics_verdict(static, dynamic, plan.least_gain)
        if verdict.gain_db < 0:
            verdicts.dynamics = verdict
        return verdict.gain_db < 0

    def _look(self, dynamic: bool, image: float | None = None) -> Look:
        rates = self.plan.motion.lr, self.plan.motion.lr_trans
        return look(self.scene, self.left_out, image or self.plan.image, dynamic, rates)

    def _finish(self, result: str, trained: bool) -> None:
        """Remedies, after the verdict: the guard chooses poses by the very views that judge. trained: steps were made,
        else a checkpoint stood at the end and all is done."""
        plan, scene, verdicts = self.plan, self.scene, self.record.verdicts
        if plan.poses_move and plan.guard and trained and result != REFUSED:
            refused = refuse_worse_poses(scene, plan.image, plan.dynamic)
            if plan.dynamic:
                verdicts.frames_kept_as_estimated_stage2 = refused
            else:
                verdicts.frames_kept_as_estimated = refused
        if trained and not plan.dynamic and self.chooser.paragraph:
            log.warning("measured on the footage: %s", self.chooser.paragraph)
        save_tensors(self.record.directory / result, self._avatar_state())
        self.save(plan.stage.steps)
        if result == REFUSED:  # the avatar is stage 1's, and so are its poses
            scene.motion.load_state_dict(load_tensors(self.record.directory / STAGE_FILES[1])["motion"])

    # --- on disk ------------------------------------------------------------------------------------------------------
    def _avatar_state(self) -> dict[str, Any]:
        scene = self.scene
        shape = {} if scene.shape is None else {"betas": torch.from_numpy(scene.shape.betas)}
        evidence = {} if scene.evidence is None else {"evidence": scene.evidence.state()}
        return (
            shape
            | evidence
            | {
                "avatar": scene.avatar.state_dict(),
                "motion": scene.motion.state_dict(),
                "stage": self.plan.number,
                "gaussians": scene.built.count(self.plan.stage.levels[-1]),
                "mask_matte": scene.footage.mask_matte,
            }
        )

    def save(self, step: int) -> None:
        """Write metrics and checkpoint of a stage of which `step` steps are done."""
        scene, record = self.scene, self.record
        record.write(len(scene.avatar.surface.points) if scene.avatar.placed else None, finished=False)
        learnt = {"exposure": scene.exposure, "shape": scene.shape} | self.optimizers
        save_tensors(
            record.directory / CHECKPOINT,
            self._avatar_state()
            | {name: part.state_dict() for name, part in learnt.items() if part is not None}
            | ({} if self.prior is None else {"prior": self.prior.state()})
            | {"step": step}
            | record.state(),
        )


def _in_bar(loss: str) -> bool:
    traits: LossTraits = LOSSES.traits(loss)
    return traits.in_progress_bar
