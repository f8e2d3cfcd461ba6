"""What one stage of training is: a schedule, deterministic in the step number alone."""

from __future__ import annotations

import math

import numpy as np
import torch

from ..config import LevelConfig, MotionConfig, StageConfig


def level_at(stage: StageConfig, step: int) -> LevelConfig:
    """The coarse-to-fine level of a step."""
    fraction = (step + 0.5) / max(1, stage.steps)
    return next(level for level in stage.levels if fraction <= level.until)


def last_level_start(stage: StageConfig) -> int:
    """The first step of the last level."""
    starts = [0.0, *(level.until for level in stage.levels[:-1])][-1]
    return next((s for s in range(int(starts * stage.steps), stage.steps) if level_at(stage, s) is stage.levels[-1]), 0)


def lr_factor(stage: StageConfig, step: int) -> float:
    """Cosine from 1 to `lr_final` over the stage."""
    fraction = step / max(1, stage.steps - 1)
    return stage.lr_final + (1 - stage.lr_final) * 0.5 * (1 + math.cos(math.pi * min(1.0, fraction)))


SHARED = 0.8  # seconds, where it is left to `auto`: the errors of an estimate go together for about so long
SHARED_AT_MOST = 1 / 8  # of the time that a capture covers: more would correct all of a short one as one frame


def sharing_width(motion: MotionConfig, progress: float, span: float = math.inf) -> float:
    """Seconds over which frames share their corrections' gradient: linear from `sharing` to `sharing_final`, neither
    more than an eighth of the `span` of the training frames, seconds."""
    share = min(1.0, progress / motion.sharing_end) if motion.sharing_end > 0 else 1.0
    start, end = (min(width, SHARED_AT_MOST * span) for width in (motion.sharing, motion.sharing_final))
    return start + (end - start) * share


def batch_rows(seed: int, count: int, batch: int, step: int, shares: np.ndarray | None = None) -> list[int]:
    """Rows of the views shown at `step`: epoch after epoch of seeded permutations, so that a resumed run goes on with
    just the rows it would have seen. Distinct within a batch (a batch larger than the data is the data).

    shares: (count,) how often each row is shown in an epoch of `count`, above zero and 1 in the mean; once each by
    default. A share that is no whole number is met over the epochs (systematic sampling)."""
    batch = min(batch, count)
    rows: list[int] = []
    position = step * batch
    while len(rows) < batch:
        order = _epoch(np.random.default_rng([seed, position // count]), count, shares)
        fresh = list(dict.fromkeys(int(r) for r in order[position % count :] if int(r) not in rows))
        rows += fresh[: batch - len(rows)]
        position = (position // count + 1) * count
    return rows


def _epoch(random: np.random.Generator, count: int, shares: np.ndarray | None) -> np.ndarray:
    """(count,) the rows of an epoch in the order in which they are shown."""
    order = random.permutation(count)
    if shares is None:
        return order
    ends = np.cumsum(shares[order])
    ends *= count / ends[-1]
    times = np.diff(np.floor(ends + random.random()), prepend=0).astype(int)
    times[-1] += count - times.sum()  # rounding, and what the random start moved past the end
    return random.permutation(np.repeat(order, np.maximum(times, 0))[:count])


def background_at(kind: str, seed: int, step: int) -> torch.Tensor:
    """(3,) the colour behind person and footage at a step."""
    if kind == "random":
        return torch.from_numpy(np.random.default_rng([seed, 7, step]).random(3, np.float32))
    return torch.full((3,), 1.0 if kind == "white" else 0.0)
