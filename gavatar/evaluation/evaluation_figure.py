"""The picture of an evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..storage import atomic
from ..training.preview import error_map
from .result import Evaluation


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
