"""Tables and figures of measured results."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..storage import atomic
from ..text_table import format_table
from ..training.preview import error_map
from .result import Evaluation


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def table(result: Evaluation) -> str:
    """The evaluation as text, with what a reader must know to use its numbers."""
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
    notes = [
        f"stage {result.run.stage} avatar, {len(result.run.avatar.surface)} Gaussians; whole frames on white; PSNR in "
        "dB, joints in mm (22 body joints, root-aligned)",
    ]
    if result.perceptual_name:
        notes.append(f"perceptual: {result.perceptual_name} (not LPIPS)")
    if result.estimated_mpjpe_mm is not None:
        before = result.estimated_mpjpe_mm
        notes.append(f"training frames before training: MPJPE {before[0]:.1f} mm, PA-MPJPE {before[1]:.1f} mm")
    if len(header) > 10:
        hands, jaw = result.estimated_parts.mpjpe_hands_mm, result.estimated_parts.jaw_deg
        notes.append(
            "hands: finger joints from their wrist, mm; jaw: degrees; training frames before training: "
            f"{_number(hands, 1)} mm, {_number(jaw, 1)} degrees"
        )
    if any(row.poses == "fitted" for row in result.rows):
        notes.append("fitted: poses were fitted to the very images that are scored; not comparable with other rows")
    return format_table(header, rows) + "\n\n" + "\n".join(notes)


def evaluation_figure(result: Evaluation, path: str | Path) -> None:
    """Each row's worst view: footage, render, error."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    count = len(result.rows)
    figure, axes = pyplot.subplots(count, 3, figsize=(7.5, 2.6 * count), squeeze=False)
    for row, (target, render), axis in zip(result.rows, result.pictures, axes, strict=True):
        pictures = (target, np.clip(render, 0, 1), error_map(target, render))
        for cell, picture, title in zip(axis, pictures, ("footage", "avatar", "error (white: 0.25)"), strict=True):
            cell.imshow(picture)
            cell.set_title(title, fontsize=7)
            cell.set_axis_off()
        axis[0].set_title(
            f"{row.split}, {row.poses} poses: {row.psnr:.2f} dB, SSIM {row.ssim:.4f}\n"
            f"worst: {row.worst.view}, {row.worst.psnr:.2f} dB",
            fontsize=7,
            loc="left",
        )
    figure.tight_layout()
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=110)
    pyplot.close(figure)
