"""Whether a run's dynamics are worth their cost: its two stages compared on frames that training never saw."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..images.metrics import perceptual_metric
from ..training.posing import pose_features
from ..training.remedies.acceptance import dynamics_verdict
from ..training.remedies.judging import detail_kept
from ..training.run import Run, open_run
from ..training.stage import STAGE_FILES
from ..training.verdicts import Look
from .result import DynamicsWorth, Evaluation, SplitScore
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
    metric = perceptual_metric()[0] if rows[0].scores[0].perceptual is not None else None
    evaluator = Evaluator(static_run, metric, progress=False, device=device)
    motion: Any = capture.truth if rows[0].poses == "true" else capture.motion
    static = [evaluator.score(row.split, row.poses, [s.view for s in row.scores], motion) for row in rows]
    views = [score.view for row in rows for score in row.scores]
    details = []
    for stage_run, dynamic in ((static_run, False), (run, True)):
        stage_run.avatar.eval()
        scene = Evaluator(stage_run, progress=False, device=device).scene(views, motion)
        details.append(detail_kept(scene, run.config.stage2.levels[-1].image, dynamic))
    still, moving = _look(static, details[0]), _look(rows, details[1])
    verdict = dynamics_verdict(still, moving, run.config.dynamics_gain)
    frames = [view.frame for view in views[:TIMED_FRAMES]]
    return DynamicsWorth(
        splits=[row.split for row in rows],
        poses=rows[0].poses,
        views=verdict.views,
        gain_db=verdict.gain_db,
        standard_error_db=verdict.standard_error_db,
        worst_gain_db=verdict.worst_gain_db,
        perceptual_ratio=verdict.perceptual_ratio,
        detail_ratio=verdict.detail_ratio,
        least_gain_db=run.config.dynamics_gain,
        cost_ms=round(1e3 * _network_seconds(run, [motion.poses[frame] for frame in frames]), 2),
        worth=verdict.kept,
        against=verdict.against,
    )


def _look(rows: list[SplitScore], detail: float) -> Look:
    scores = [score for row in rows for score in row.scores]
    distances = [score.perceptual for score in scores if score.perceptual is not None]
    return Look([10 ** (-score.psnr / 10) for score in scores], distances or None, detail)


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
