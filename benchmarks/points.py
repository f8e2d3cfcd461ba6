"""Runs side by side: where their points are, how even, how they score, what can be seen through, and their rims.

python benchmarks/points.py RUN... [--every 4] [--pixel 1.0] [--json points.json] [--pictures FOLDER]

Each RUN is a run directory of `gavatar-train`, of whatever policy of points. Of every split with true poses the avatar
of stage 1 is drawn in those (without, in the estimated ones):

  spread       by which share of its mean the distance to the nearest point varies (random places 0.52, a grid 0)
  psnr         dB, whole frames on white
  through x1   share of the pixels inside the eroded mask where more than 2 % of the background shows; x2, x4: with the
               same camera at twice and four times the pixels
  rim          mean difference of brightness to the truth in the 3 pixels about the mask's border, on black and on white
               (0 to 1; a pale fringe on dark is above 0 on black, a dark one on white below 0 there)
  rim dB       PSNR of the same pixels
  rim alpha    mean difference of opacity to the mask there: above 0 where the silhouette is too wide
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from gavatar.avatar.blue_noise import spread
from gavatar.evaluation.close_ups import close_ups
from gavatar.evaluation.scores import Evaluator
from gavatar.registry import load_plugins
from gavatar.storage import write_image, write_json
from gavatar.text_table import format_table
from gavatar.training.posing import attributes_in
from gavatar.training.run import Run, open_run

OPAQUE = 0.98
ERODED = 3  # pixels inside the mask, at its own size
SIZES = (1, 2, 4)
BLACK, WHITE = torch.zeros(3), torch.ones(3)


@torch.no_grad()
def of_view(evaluator: Evaluator, scene: Any, view: Any, motion: Any, pixel: float | None) -> dict[str, float]:
    """All numbers of one view. pixel: metres that a training pixel spanned, by which finer ones widen Gaussians."""
    run = evaluator.run
    color, alpha = run.capture.load(view)
    camera, attributes = run.capture.camera(view), attributes_in(run, motion, view.frame)
    pose = scene.motion([view.frame])
    inside = cv2.erode((alpha > 0.5).astype(np.uint8), np.ones((2 * ERODED + 1,) * 2, np.uint8))
    row: dict[str, float] = {}
    for size in SIZES:
        _, seen = scene.draw(attributes, pose, [camera.scaled(size)], pixel=pixel)
        mask = cv2.resize(inside, seen.shape[:0:-1], interpolation=cv2.INTER_NEAREST) > 0
        row[f"through x{size}"] = float((seen[0].numpy()[mask] < OPAQUE).mean()) if mask.any() else 0.0
    soft = (alpha > 0.5).astype(np.uint8)
    kernel = np.ones((3, 3), np.uint8)
    border = cv2.dilate(soft, kernel).astype(bool) & ~cv2.erode(soft, kernel).astype(bool)
    for name, behind in (("black", BLACK), ("white", WHITE)):
        drawn, opacity = scene.draw(attributes, pose, [camera], behind, pixel=pixel)
        image, truth = drawn[0].permute(1, 2, 0).clamp(0, 1).numpy(), color + (1 - alpha[..., None]) * behind.numpy()
        if border.any():
            wrong = (image - truth)[border]
            row[f"rim {name}"], row[f"rim {name} dB"] = float(wrong.mean()), float(-10 * np.log10(np.mean(wrong**2)))
            row["rim alpha"] = float((opacity[0].numpy() - alpha)[border].mean())
        if name == "white":
            row["psnr"] = float(-10 * np.log10(np.mean((image - truth) ** 2)))
    return row


def measured(directory: Path, every: int, factor: float = 1.0) -> tuple[Run, list[dict[str, Any]]]:
    """A row for each split of a run, drawn as if a training pixel had been `factor` times as large."""
    run = open_run(directory, 1)
    evaluator, pixel = Evaluator(run, progress=False), None if run.pixel is None else factor * run.pixel
    motion = run.capture.truth or run.capture.motion
    rows = []
    for split, views in run.capture.splits.items():
        if split in ("train", run.config.train_split) or not views:
            continue
        scene = evaluator.scene(views[::every], motion)
        per_view = [of_view(evaluator, scene, view, motion, pixel) for view in views[::every]]
        means = {key: float(np.mean([view[key] for view in per_view if key in view])) for key in per_view[0]}
        about = {"run": directory.name, "policy": run.config.points["name"], "gaussians": len(run.avatar.surface)}
        rows.append(
            {
                **about,
                "pixel": factor,
                "spread": spread(run.avatar.surface),
                "split": split,
                "views": len(per_view),
                **means,
            }
        )
    return run, rows


def pictures(run: Run, folder: Path) -> None:
    """Close views of the avatar in the first frame of a split with true poses, on black and on white."""
    motion = run.capture.truth or run.capture.motion
    views = next(views for split, views in run.capture.splits.items() if split != run.config.train_split and views)
    for name, behind in (("black", BLACK), ("white", WHITE)):
        parts = close_ups(run, motion, views[0].frame, 384, behind).values()
        write_image(folder / f"{run.directory.name}_{name}.png", np.concatenate(list(parts), 1))


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--every", type=int, default=4, help="score each Nth view of a split (%(default)s)")
    parser.add_argument("--pixel", type=float, default=1.0, help="take training pixels as this many times as large")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="write close views of each run")
    arguments = parser.parse_args(argv)
    warnings.simplefilter("ignore")
    load_plugins()
    rows: list[dict[str, Any]] = []
    for directory in arguments.runs:
        run, more = measured(directory, arguments.every, arguments.pixel)
        rows += more
        if arguments.pictures:
            pictures(run, arguments.pictures)
    shown = [{k: f"{v:.4f}" if isinstance(v, float) else str(v) for k, v in row.items()} for row in rows]
    print(format_table(list(shown[0]), [list(row.values()) for row in shown]))
    if arguments.json:
        write_json(arguments.json, rows)


if __name__ == "__main__":
    main()
