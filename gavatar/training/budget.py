"""A training that fits into the minutes there are: its steps are measured here, then its schedule is scaled."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from ..config import StageConfig, TrainConfig
from .plan import LEAST_STEPS
from .stage import Stage
from .trainer import Trainer

ALLOWED = 0.8  # of the minutes for steps; remedies, verdicts and files take the rest
LONGEST = 3.0  # times the preset's steps: more of the same teaches hardly anything
DYNAMICS_FROM = 0.5  # of the preset's steps: with fewer the still look has all the time
TIMED = 2  # steps of a level, after one that loads and allocates


@dataclasses.dataclass(frozen=True)
class LevelCost:
    """What a level of a stage asks for: steps of it, and seconds a step as measured here."""

    stage: int
    steps: int
    seconds: float


def scaled(config: TrainConfig, costs: list[LevelCost], seconds: float) -> TrainConfig:
    """The configuration with as many steps as `seconds` allow at these costs, all levels in proportion.

    Stage 2 is left out where less than half of its preset's steps would be done; stage 1 has at least the steps from
    which on the shape is tried, or its preset's if these are fewer."""
    whole = sum(cost.steps * cost.seconds for cost in costs)
    first = sum(cost.steps * cost.seconds for cost in costs if cost.stage == 1)
    if not first > 0:
        return config
    factor, second = min(LONGEST, seconds / whole), config.stage2.steps
    if factor < DYNAMICS_FROM:
        factor, second = min(LONGEST, seconds / first), 0
    least = min(LEAST_STEPS, config.stage1.steps)
    steps = max(least, round(config.stage1.steps * factor))
    return dataclasses.replace(
        config,
        stage1=dataclasses.replace(config.stage1, steps=steps),
        stage2=dataclasses.replace(config.stage2, steps=round(second * factor)),
    )


def level_costs(trainer: Trainer, clock: Callable[[], float] = time.perf_counter) -> list[LevelCost]:
    """Seconds a step of every level, by making a few of them. The trainer is spent then."""
    costs = []
    for plan in trainer.plans:
        steps = plan.stage.steps
        stage = trainer.stage(plan.number)
        stage.plan = dataclasses.replace(
            stage.plan, exposure_step=None, shape_step=None, mend_step=None, prior_step=None, preview_every=steps + 1
        )
        trainer.scene.avatar.train()
        for first, count in level_steps(plan.stage):
            costs.append(LevelCost(plan.number, count, _seconds(stage, first, clock)))
    return costs


def level_steps(stage: StageConfig) -> list[tuple[int, int]]:
    """The first step of each level that has any, and how many it has."""
    ends = [min(stage.steps, max(0, math.floor(level.until * stage.steps + 0.5))) for level in stage.levels]
    starts = [0, *ends[:-1]]
    return [(start, end - start) for start, end in zip(starts, ends, strict=True) if end > start]


def _seconds(stage: Stage, first: int, clock: Callable[[], float]) -> float:
    """Of a step from `first` on, the shortest of a few: what else the machine does is not the step's."""
    took = []
    for step in [first, *[first] * TIMED]:
        began = clock()
        stage.step(step)
        took.append(clock() - began)
    return min(took[1:])


def within(config: TrainConfig) -> TrainConfig:
    """The configuration for `config.minutes`, as measured here by a few steps of it in a folder of their own."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(config, Path(folder))
        costs = level_costs(trainer)
    left = 60 * config.minutes * ALLOWED - (time.perf_counter() - began)
    return scaled(config, costs, max(0.0, left))
