"""How good a run is: images against the footage, joints against the truth where the capture has it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from gavatar_runtime.render.widening import as_trained
from gavatar_runtime.values.body import check_motion_fits
from gavatar_runtime.values.gaussians import Gaussians
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.skeletons import FINGERS

from ..assemble import AvatarBuild, build_rasterizer
from ..attributes import Attributes
from ..avatar.trainable import Avatar
from ..capture.capture import Capture, View
from ..images.image_quality import mean_psnr, psnr, ssim
from ..images.metrics import joint_errors, mpjpe_hands, perceptual_metric, rotation_errors
from ..losses import LossComposer, LossInputs, MotionState
from ..storage import write_json
from ..training.footage import footage, load_full
from ..training.motion_table import MotionTable, RowAdam
from ..training.run import Run

if TYPE_CHECKING:
    from .dynamics import DynamicsWorth

WHITE = (1.0, 1.0, 1.0)
POSES = {
    "refined": "poses as training refined them",
    "estimated": "poses of body.npz, as given",
    "true": "the capture's true poses",
    "fitted": "poses of body.npz fitted to these images with the avatar frozen",
}


@dataclasses.dataclass
class ViewScore:
    """One rendered view against its footage, both on white, whole frame. psnr: dB. perceptual: distance or None."""

    view: View
    psnr: float
    ssim: float
    perceptual: float | None


@dataclasses.dataclass
class PartErrors:
    """Errors of what the 22 body joints leave out, each None where the truth holds it still. mpjpe_hands_mm: of finger
    joints, from their wrist. jaw_deg: of the jaw's rotation, whose joint itself hardly moves."""

    mpjpe_hands_mm: float | None = None
    jaw_deg: float | None = None

    def as_json(self, prefix: str = "", when: str = "") -> dict:
        """The two numbers under `{prefix}mpjpe_hands{when}_mm` and `{prefix}jaw{when}_deg`."""
        values = {f"{prefix}mpjpe_hands{when}_mm": self.mpjpe_hands_mm, f"{prefix}jaw{when}_deg": self.jaw_deg}
        return {key: None if value is None else round(value, 2) for key, value in values.items()}


@dataclasses.dataclass
class SplitScore:
    """One row of the table: a split rendered with one source of poses."""

    split: str
    poses: str
    scores: list[ViewScore]
    mpjpe_mm: float | None = None
    pa_mpjpe_mm: float | None = None
    parts: PartErrors = dataclasses.field(default_factory=PartErrors)

    @property
    def psnr(self) -> float:
        return mean_psnr([s.psnr for s in self.scores])

    @property
    def ssim(self) -> float:
        return float(np.mean([s.ssim for s in self.scores]))

    @property
    def perceptual(self) -> float | None:
        values = [s.perceptual for s in self.scores if s.perceptual is not None]
        return float(np.mean(values)) if values else None

    @property
    def worst(self) -> ViewScore:
        return min(self.scores, key=lambda s: s.psnr)

    def as_json(self) -> dict:
        worst = self.worst
        return {
            "split": self.split,
            "poses": self.poses,
            "views": len(self.scores),
            "psnr": round(self.psnr, 3),
            "ssim": round(self.ssim, 5),
            "perceptual": None if self.perceptual is None else round(self.perceptual, 5),
            "worst_view": str(worst.view),
            "worst_psnr": round(worst.psnr, 3),
            "mpjpe_mm": None if self.mpjpe_mm is None else round(self.mpjpe_mm, 2),
            "pa_mpjpe_mm": None if self.pa_mpjpe_mm is None else round(self.pa_mpjpe_mm, 2),
            **self.parts.as_json(),
        }


@torch.no_grad()
def pose_features(avatar: Avatar, built: AvatarBuild, poses: np.ndarray) -> Tensor | None:
    """Pose features of (B, J, 3) axis-angle poses, or None for a static avatar."""
    if avatar.encoder is None:
        return None
    return avatar.encode(*built.encoder_tensors(poses))


@torch.no_grad()
def posed(run: Run, motion: Motion, frame: int, static: Attributes | None = None) -> Gaussians:
    """The trained avatar's Gaussians in the pose of one frame of `motion`, torch tensors. static: the attributes of an
    avatar without encoder, where they were decoded before."""
    one = motion.taken([frame])
    poses = check_motion_fits(one.poses, run.built.body.data.num_joints)
    attributes = static or run.avatar.attributes(pose_features(run.avatar, run.built, poses))
    table = MotionTable(one, poses.shape[1]).to(run.avatar.features.device)
    return run.avatar.pose(attributes, *table(), table.expression())[0]


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
        self._static = None
        if run.avatar.encoder is None:
            with torch.no_grad():
                self._static = run.avatar.attributes()

    @torch.no_grad()
    def render(self, view: View, motion: Motion) -> np.ndarray:
        """(H, W, 3) float32 image of the avatar on white in the pose that `motion` has at the view's frame."""
        return self._render(view, motion).cpu().numpy()

    def _render(self, view: View, motion: Motion) -> Tensor:
        camera = self.run.capture.camera(view)
        gaussians = posed(self.run, motion, view.frame, self._static)
        return self.rasterize(as_trained(gaussians, camera, self.run.pixel), camera, WHITE).color

    @torch.no_grad()
    def score(self, split: str, poses: str, views: Sequence[View], motion: Motion) -> SplitScore:
        """Scores of `views` with the poses of `motion`, and its joint error over their frames where truth exists."""
        scores = []
        for view in tqdm(views, desc=f"{split}, {poses} poses", unit="view", disable=not self.progress, leave=False):
            color, alpha = self.run.capture.load(view)
            target = torch.from_numpy(color + (1 - alpha[..., None])).permute(2, 0, 1)[None].to(self.device)
            image = self._render(view, motion).permute(2, 0, 1)[None].clamp(0, 1)
            distance = None if self.perceptual is None else float(self.perceptual(image, target))
            scores.append(ViewScore(view, float(psnr(image, target)), float(ssim(image, target)), distance))
        result = SplitScore(split, poses, scores)
        if self.run.capture.truth is not None:
            frames = sorted({view.frame for view in views})
            result.mpjpe_mm, result.pa_mpjpe_mm = motion_errors(self.run.built, motion, self.run.capture.truth, frames)
            result.parts = part_errors(self.run.built, motion, self.run.capture.truth, frames)
        return result

    def fit(self, views: Sequence[View], steps: int = 60, image_scale: float = 1.0) -> Motion:
        """The capture's motion with the frames of `views` fitted to their images, avatar frozen.

        The same losses, learning rates and row-wise Adam as stage 1; every view is seen at every step. Pose features
        are those of the estimated pose while fitting.
        """
        return fit_motion(self.run, self.rasterize, views, steps, image_scale, self._static, self.progress)


def fit_motion(
    run: Run, rasterize, views: Sequence[View], steps: int, image_scale: float, static=None, progress: bool = True
) -> Motion:
    """See `Evaluator.fit`."""
    capture, config, avatar = run.capture, run.config, run.avatar
    data = footage(
        capture,
        list(views),
        load_full(capture, list(views), mask_matte=config.mask_matte),
        image_scale,
        config.crop,
        config.mask_edge,
    )
    device = avatar.features.device
    table = MotionTable(capture.motion, run.built.body.data.num_joints, config.motion.joints).to(device)
    frames = sorted({view.frame for view in views})
    row = {frame: i for i, frame in enumerate(frames)}
    poses = check_motion_fits(capture.motion.poses[frames], run.built.body.data.num_joints)
    losses = LossComposer(
        {k: v for k, v in config.losses.items() if k not in ("feature", "pose_feature", "perceptual", "lpips")}
    )
    optimizer = RowAdam(
        [
            {"params": [table.rotation_correction], "lr": config.motion.lr},
            {"params": [table.trans_correction], "lr": config.motion.lr_trans},
        ]
    )
    attributes = {}
    with torch.no_grad():
        for i, frame in enumerate(frames):
            attributes[frame] = static or avatar.attributes(pose_features(avatar, run.built, poses[i : i + 1]))
    times = torch.tensor(frames, dtype=torch.float32, device=device) / table.fps
    chunk = 8
    for step in tqdm(range(steps), desc="fitting held-out poses", unit="step", disable=not progress, leave=False):
        factor = 0.5 * (1 + np.cos(np.pi * step / max(1, steps)))
        for group, lr in zip(optimizer.param_groups, (config.motion.lr, config.motion.lr_trans), strict=True):
            group["lr"] = lr * max(0.05, factor)
        optimizer.zero_grad()
        for start in range(0, len(views), chunk):
            part = list(range(start, min(start + chunk, len(views))))
            rotations, trans = table(frames)
            images, alphas = [], []
            for r in part:
                view, camera = data.views[r], data.cameras[r]
                i = row[view.frame]
                pose = rotations[i : i + 1], trans[i : i + 1], table.expression([view.frame])
                (gaussians,) = avatar.pose(attributes[view.frame], *pose)
                rendering = rasterize(gaussians, camera, WHITE)
                images.append(rendering.color.permute(2, 0, 1))
                alphas.append(rendering.alpha)
            target, mask = data.batch(part, torch.ones(3), device)
            motion = MotionState(
                rotations=rotations,
                rotations_initial=table.initial_rotations[frames],
                trans=trans,
                trans_initial=table.initial_trans[frames],
                frame_times=times,
            )
            target, render, mask, alpha = data.believed(part, target, mask, torch.stack(images), torch.stack(alphas))
            inputs = LossInputs(render=render, target=target, alpha=alpha, mask=mask, motion=motion)
            losses(inputs)[0].backward()
        optimizer.step(torch.tensor(frames, device=device))
    return table.motion("fitted")


def motion_errors(built: AvatarBuild, motion: Motion, truth: Motion, frames: Sequence[int]) -> tuple[float, float]:
    """MPJPE (root-aligned) and PA-MPJPE in millimetres over the 22 body joints of the given frames."""
    return joint_errors(*(joints_of(built, m, frames) for m in (motion, truth)))


def part_errors(built: AvatarBuild, motion: Motion, truth: Motion, frames: Sequence[int]) -> PartErrors:
    """Errors of hands and jaw over the given frames, where the truth moves them out of their rest pose."""
    data, frames = built.body.data, list(frames)
    names, true_poses = list(data.joint_names), check_motion_fits(truth.poses[frames], data.num_joints)
    moved = np.abs(true_poses - data.rest_pose).max((0, 2)) > 1e-4
    out = PartErrors()
    if any(moved[names.index(name)] for name in FINGERS if name in names):
        out.mpjpe_hands_mm = float(mpjpe_hands(*(joints_of(built, m, frames) for m in (motion, truth)), names).mean())
    if "jaw" in names and moved[names.index("jaw")]:
        jaw = names.index("jaw")
        poses = check_motion_fits(motion.poses[frames], data.num_joints)
        out.jaw_deg = float(rotation_errors(poses[:, jaw], true_poses[:, jaw]).mean())
    return out


@torch.no_grad()
def joints_of(built: AvatarBuild, motion: Motion, frames: Sequence[int]) -> np.ndarray:
    """(F, J, 3) metres, world."""
    skeleton = built.avatar.skeleton
    table = MotionTable(motion.taken(list(frames)), len(skeleton.parents))
    rotations, trans = table.to(skeleton.joints.device)()
    return (skeleton.posed_joints(rotations) + trans[:, None]).cpu().numpy()


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


@dataclasses.dataclass
class Evaluation:
    """Everything `gavatar-eval` measured. pictures: (target, render) of each row's worst view, in row order.
    estimated_mpjpe_mm: error of the training frames' poses before training, and its PA form; estimated_parts: of hands
    and jaw."""

    run: Run
    rows: list[SplitScore]
    pictures: list[tuple[np.ndarray, np.ndarray]]
    perceptual_name: str | None
    estimated_mpjpe_mm: tuple[float, float] | None = None
    estimated_parts: PartErrors = dataclasses.field(default_factory=PartErrors)
    dynamics: DynamicsWorth | None = None

    def row(self, split: str, poses: str) -> SplitScore:
        """The row of a split and a source of poses; KeyError if it was not measured."""
        for row in self.rows:
            if (row.split, row.poses) == (split, poses):
                return row
        raise KeyError(f"{split} with {poses} poses")

    def as_json(self) -> dict:
        before = self.estimated_mpjpe_mm
        return {
            "run": str(self.run.directory),
            "stage": self.run.stage,
            "gaussians": len(self.run.avatar.surface),
            "protocol": "whole frames composited on white, mean over views; see `poses` of each row",
            "pose_sources": POSES,
            "perceptual_network": self.perceptual_name,
            "train_mpjpe_before_mm": None if before is None else round(before[0], 2),
            "train_pa_mpjpe_before_mm": None if before is None else round(before[1], 2),
            **self.estimated_parts.as_json("train_", "_before"),
            "dynamics": None if self.dynamics is None else dataclasses.asdict(self.dynamics),
            "rows": [row.as_json() for row in self.rows],
        }

    def write(self, path) -> None:
        """Write `as_json` to `path`."""
        write_json(path, self.as_json())


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
        motion = evaluator.fit(views, fit_steps) if poses == "fitted" else sources[poses]
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
