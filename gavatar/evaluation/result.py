"""What an evaluation measured, as values."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np

from ..capture.capture import View
from ..images.image_quality import mean_psnr
from ..storage import write_json
from ..text_table import format_table
from ..training.run import Run
from .joint_errors import PartErrors

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

    def as_json(self) -> dict[str, Any]:
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


@dataclasses.dataclass
class DynamicsWorth:
    """splits: held out, of which the views are. poses: that both stages were rendered in. gain_db: mean gain in PSNR
    of stage 2 over stage 1, view by view; standard_error_db: of that mean, None for one view. worst_gain_db,
    perceptual_ratio, detail_ratio, against: as in `gavatar.training.verdicts.DynamicsVerdict`. least_gain_db: asked for
    by `dynamics_gain`. cost_ms: median time of a frame's networks, which a static avatar does not run, in PyTorch on
    the machine of the evaluation. worth: nothing speaks against them."""

    splits: list[str]
    poses: str
    views: int
    gain_db: float
    standard_error_db: float | None
    worst_gain_db: float | None
    perceptual_ratio: float | None
    detail_ratio: float | None
    least_gain_db: float
    cost_ms: float
    worth: bool
    against: list[str]

    def sentence(self) -> str:
        """For people."""
        error = "" if self.standard_error_db is None else f" (standard error {self.standard_error_db:.2f})"
        says = "worth" if self.worth else f"not worth ({', '.join(self.against)})"
        more = [] if self.worst_gain_db is None else [f"{self.worst_gain_db:+.2f} dB in the worst"]
        if self.perceptual_ratio is not None:
            more.append(f"{100 * (self.perceptual_ratio - 1):+.0f} % perceptual distance")
        if self.detail_ratio is not None:
            more.append(f"{100 * self.detail_ratio:.0f} % of the detail in a motion that nobody filmed")
        text = (
            f"dynamics gain {self.gain_db:+.2f} dB{error}, {', '.join(more)}, on {self.views} held-out views of "
            f"{', '.join(self.splits)}, {self.poses} poses: {says} their cost of {self.cost_ms:.0f} ms a frame "
            "(networks in PyTorch, here)"
        )
        return text if self.worth else f"{text}; gavatar-export --stage 1 leaves them out"


@dataclasses.dataclass(repr=False)
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

    def __repr__(self) -> str:
        return f"<Evaluation of {self.run.directory}, stage {self.run.stage}: {len(self.rows)} rows>"

    def __str__(self) -> str:
        """The table, with what a reader must know to use its numbers, and the verdict on dynamics."""
        notes = [*_notes(self), *([] if self.dynamics is None else [self.dynamics.sentence()])]
        return _table(self) + "\n\n" + "\n".join(notes)

    def row(self, split: str, poses: str) -> SplitScore:
        """The row of a split and a source of poses; KeyError if it was not measured."""
        for row in self.rows:
            if (row.split, row.poses) == (split, poses):
                return row
        raise KeyError(f"{split} with {poses} poses")

    def as_json(self) -> dict[str, Any]:
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

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write `as_json` to `path`."""
        write_json(path, self.as_json())


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _table(result: Evaluation) -> str:
    header = ["split", "poses", "views", "PSNR", "SSIM", "perceptual", "worst PSNR", "worst view", "MPJPE", "PA-MPJPE"]
    rows = [
        [
            row.split,
            row.poses,
            str(len(row.scores)),
            _number(row.psnr, 2),
            _number(row.ssim, 4),
            _number(row.perceptual, 4),
            _number(row.worst.psnr, 2),
            str(row.worst.view),
            _number(row.mpjpe_mm, 1),
            _number(row.pa_mpjpe_mm, 1),
        ]
        for row in result.rows
    ]
    for name, title in (("mpjpe_hands_mm", "hands"), ("jaw_deg", "jaw")):
        values = [getattr(row.parts, name) for row in result.rows]
        if any(value is not None for value in values):
            header.append(title)
            rows = [[*row, _number(value, 1)] for row, value in zip(rows, values, strict=True)]
    return format_table(header, rows)


def _notes(result: Evaluation) -> list[str]:
    notes = [
        f"stage {result.run.stage} avatar, {len(result.run.avatar.surface)} Gaussians; whole frames on white; PSNR in "
        "dB, joints in mm (22 body joints, root-aligned)",
    ]
    if result.perceptual_name:
        notes.append(f"perceptual: {result.perceptual_name} (not LPIPS)")
    if result.estimated_mpjpe_mm is not None:
        before = result.estimated_mpjpe_mm
        notes.append(f"training frames before training: MPJPE {before[0]:.1f} mm, PA-MPJPE {before[1]:.1f} mm")
    if any(row.parts != PartErrors() for row in result.rows):
        hands, jaw = result.estimated_parts.mpjpe_hands_mm, result.estimated_parts.jaw_deg
        notes.append(
            "hands: finger joints from their wrist, mm; jaw: degrees; training frames before training: "
            f"{_number(hands, 1)} mm, {_number(jaw, 1)} degrees"
        )
    if any(row.poses == "fitted" for row in result.rows):
        notes.append("fitted: poses were fitted to the very images that are scored; not comparable with other rows")
    return notes
