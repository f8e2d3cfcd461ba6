"""A training of so many minutes: steps are scaled to what they cost here, once, and the run says so."""

from __future__ import annotations

import dataclasses

import pytest
from omegaconf import OmegaConf
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import StageConfig, TrainConfig, check, compose_config
from gavatar.training.budget import LONGEST, LevelCost, level_costs, level_steps, scaled
from gavatar.training.plan import LEAST_STEPS
from gavatar.training.run import train
from gavatar.training.schedule import level_at
from gavatar.training.trainer import Trainer
from gavatar_runtime.errors import UserError

COSTS = [LevelCost(1, 600, 0.1), LevelCost(1, 400, 0.3), LevelCost(2, 200, 0.4)]  # 60 + 120 + 80 seconds
ASKED = TrainConfig(stage1=StageConfig(steps=1000), stage2=StageConfig(steps=200))


def steps(config: TrainConfig) -> tuple[int, int]:
    return config.stage1.steps, config.stage2.steps


def test_steps_grow_and_shrink_with_the_time_there_is():
    assert steps(scaled(ASKED, COSTS, 260)) == (1000, 200)
    assert steps(scaled(ASKED, COSTS, 390)) == (1500, 300)
    assert steps(scaled(ASKED, COSTS, 1e6)) == (LONGEST * 1000, LONGEST * 200)
    assert steps(ASKED) == (1000, 200)


def test_a_short_time_goes_to_the_still_look_alone():
    assert steps(scaled(ASKED, COSTS, 90)) == (500, 0)  # less than half of 260 s: 90 of stage 1's 180 s
    assert steps(scaled(ASKED, COSTS, 0)) == (LEAST_STEPS, 0)


def test_levels_have_the_steps_that_the_schedule_gives_them():
    stage = check(compose_config(["capture=x", "out=x", "experiment=default"])).stage1
    for first, count in level_steps(stage):
        level = level_at(stage, first)
        assert all(level_at(stage, step) is level for step in (first, first + count - 1))
    assert sum(count for _, count in level_steps(stage)) == stage.steps


def test_a_trainer_tells_what_every_level_costs(tmp_path):
    capture = write_tiny_capture(tmp_path / "footage")
    trainer = Trainer(check(compose_config([*SMALL, f"capture={capture}", f"out={tmp_path}"])), tmp_path)
    costs = level_costs(trainer)
    assert [(cost.stage, cost.steps) for cost in costs] == [(1, 3), (1, 3), (2, 4)]
    assert all(cost.seconds > 0 for cost in costs)


def test_a_run_writes_down_its_steps_and_goes_on_with_them(tmp_path, monkeypatch):
    capture, run = write_tiny_capture(tmp_path / "footage"), tmp_path / "run"
    asked = [*SMALL, "stage1.steps=1000", f"capture={capture}", f"out={run}"]

    def few(config: TrainConfig) -> TrainConfig:
        return dataclasses.replace(config, stage1=dataclasses.replace(config.stage1, steps=10))

    monkeypatch.setattr("gavatar.training.run.within", few)
    composed = compose_config([*asked, "minutes=1"])
    train(composed, run)
    assert OmegaConf.load(run / "config.yaml").stage1.steps == 10
    monkeypatch.setattr("gavatar.training.run.within", lambda *_: pytest.fail("measured again"))
    train(composed, run)
    with pytest.raises(UserError, match="minutes"):
        train(compose_config([*asked, "minutes=2"]), run)


def test_minutes_are_a_number():
    with pytest.raises(UserError, match="minutes must be a number of at least 0, not -1"):
        check(compose_config(["capture=x", "out=x", "minutes=-1"]))


def test_a_page_shows_the_latest_picture(tmp_path):
    capture, run = write_tiny_capture(tmp_path / "footage"), tmp_path / "run"
    train(compose_config([*SMALL, "stage2.steps=0", f"capture={capture}", f"out={run}"]), run)
    page = (run / "previews" / "live.html").read_text()
    assert "the training is finished" in page
    assert "latest.png" in page
    latest, last = ((run / "previews" / name).read_bytes() for name in ("latest.png", "stage1_000005.png"))
    assert latest == last
