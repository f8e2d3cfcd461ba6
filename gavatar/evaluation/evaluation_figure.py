"""The picture of an evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..assemble import build_rasterizer
from ..storage import atomic
from ..training.preview import error_map
from ..training.remedies.evidence_picture import drawn_evidence
from .result import Evaluation


def evaluation_figure(result: Evaluation, path: str | Path) -> None:
    """Each row's worst view: footage, render, error; and below, the body coloured by what training saw of it, where the
    run says so."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    count, run = len(result.rows), result.run
    below = 0 if run.evidence is None else 1
    figure = pyplot.figure(figsize=(7.5, 2.6 * count + 2.4 * below))
    grid = figure.add_gridspec(count + below, 3)
    axes = [[figure.add_subplot(grid[row, column]) for column in range(3)] for row in range(count)]
    if run.evidence is not None:
        cell = figure.add_subplot(grid[count, :])
        rasterize = build_rasterizer(run.config.rasterizer, run.avatar)
        cell.imshow(drawn_evidence(run.avatar, rasterize, run.evidence.on(run.avatar.surface)))
        cell.set_title("what training saw of each part", fontsize=7, loc="left")
        cell.set_axis_off()
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
