"""Whether a run's dynamics are worth their cost: its two stages compared on frames that training never saw."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..training.posing import pose_features
from ..training.remedies.acceptance import dynamics_verdict
from ..training.run import Run, open_run
from ..training.stage import STAGE_FILES
from .result import DynamicsWorth, Evaluation
from .scores import Evaluator

TIMED_FRAMES = 9


def weigh_dynamics(result: Evaluation, device: str | torch.device = "cpu") -> DynamicsWorth | None:
    """The verdict on an evaluated run, or None where there is nothing to compare: a run of one stage, an evaluation of
    its stage 1, or one without rows of frames held out of training in true or estimated poses.

    Reuses the rows of `result` and renders their views once more with the avatar of stage 1.
    """
    run, capture = result.run, result.run.capture
    if run.stage != 2 or not (Path(run.directory) / STAGE_FILES[1]).exists():
        return None
    trained = {view.frame for view in capture.views(run.config.train_split)}
    rows = [
        row
        for row in result.rows
        if row.poses in ("true", "estimated") and not any(score.view.frame in trained for score in row.scores)
    ]
    if not rows:
        return None
    static_run = open_run(run.directory, 1, run.config.capture)
    static_run.config.rasterizer = run.config.rasterizer
    evaluator = Evaluator(static_run, progress=False, device=device)
    motion: Any = capture.truth if rows[0].poses == "true" else capture.motion
    errors: dict[str, list[float]] = {"static": [], "dynamic": []}
    for row in rows:
        static = evaluator.score(row.split, row.poses, [score.view for score in row.scores], motion)
        for name, scores in (("static", static.scores), ("dynamic", row.scores)):
            errors[name] += [10 ** (-score.psnr / 10) for score in scores]
    verdict = dynamics_verdict(np.array(errors["static"]), np.array(errors["dynamic"]), run.config.dynamics_gain)
    frames = [score.view.frame for row in rows for score in row.scores]
    return DynamicsWorth(
        splits=[row.split for row in rows],
        poses=rows[0].poses,
        views=verdict.views,
        gain_db=verdict.gain_db,
        standard_error_db=verdict.standard_error_db,
        least_gain_db=run.config.dynamics_gain,
        cost_ms=round(1e3 * _network_seconds(run, [motion.poses[frame] for frame in frames[:TIMED_FRAMES]]), 2),
        worth=verdict.kept,
    )


@torch.no_grad()
def _network_seconds(run: Run, poses: list[np.ndarray]) -> float:
    """Median seconds of encoding and decoding one pose; each is timed twice, since the first run is slow."""
    seconds, device = [], next(run.avatar.parameters()).device
    for pose in [poses[0], *poses, *poses]:
        start = time.perf_counter()
        run.avatar.attributes(pose_features(run.avatar, run.built, pose[None]))
        if device.type == "cuda":
            torch.cuda.synchronize(device)  # else only the launch of its kernels is timed
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[1:]))
