"""Another shape is tried on some views and judged on others; the trial leaves no trace."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import LevelConfig, check, compose_config
from gavatar.training.remedies.shape_trial import shape_trial
from gavatar.training.trainer import Trainer

SETTINGS = [*(o for o in SMALL if not o.startswith("encoder")), "encoder=none", "stage1.batch=4", "stage1.steps=60"]
SETTINGS += ["stage1.levels=[{until:1.0,uv:64,image:0.25}]", "stage1.lr_decoder=0.01", "motion.enabled=false"]


def scene_of(folder, out, steps, off=0.0, frames=tuple(range(0, 60, 6))):
    """An avatar after some steps on true poses and a body whose first coefficient is off."""
    write_tiny_capture(folder, frames=frames)
    with np.load(folder / "body_truth.npz") as truth, np.load(folder / "body.npz") as given:
        arrays = dict(given) | {key: truth[key] for key in ("poses", "trans")}
    arrays["betas"] = arrays["betas"] + off * np.eye(1, arrays["betas"].size)[0]
    np.savez(folder / "body.npz", **arrays)
    trainer = Trainer(check(compose_config([f"capture={folder}", f"out={out}", *SETTINGS])), out)
    trainer.scene.avatar.train()
    stage = trainer.stage(1)
    for step in range(steps):
        stage.step(step)
    trainer.scene.place(LevelConfig(uv=64))
    return trainer.scene


def test_a_wrong_shape_gains_and_a_right_one_hardly(tmp_path):
    right, wrong = (
        shape_trial(scene_of(tmp_path / name, tmp_path / "run", 30, off), 0.25)
        for name, off in (("right", 0.0), ("wrong", 1.5))
    )
    assert wrong.gain_db > 2 * right.gain_db
    assert wrong.change[0] < right.change[0] - 0.3  # back towards where it was


def test_the_trial_changes_nothing_and_is_the_same_each_time(tmp_path):
    scene = scene_of(tmp_path / "tiny", tmp_path / "run", 3)
    before = copy.deepcopy([scene.avatar.state_dict(), scene.motion.state_dict()])
    first, second = shape_trial(scene, 0.25), shape_trial(scene, 0.25)
    assert first.gain_db == second.gain_db
    np.testing.assert_array_equal(first.change, second.change)
    for state, part in zip(before, (scene.avatar, scene.motion), strict=True):
        assert all(torch.equal(state[key], value) for key, value in part.state_dict().items())
    assert scene.avatar.training
    assert scene.shape is None
    assert all(p.grad is None or p.requires_grad for p in scene.avatar.parameters())


@pytest.mark.parametrize("count", [1, 7])
def test_too_few_views_tell_nothing(tmp_path, count):
    scene = scene_of(tmp_path / "tiny", tmp_path / "run", 0, frames=tuple(range(count)))
    assert shape_trial(scene, 0.25) is None
