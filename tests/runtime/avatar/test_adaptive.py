"""Frames kept within a budget of time."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gavatar_runtime.avatar.adaptive import PATIENCE, RECOVERY, AdaptiveAvatar
from gavatar_runtime.errors import UserError


def test_a_budget_makes_frames_cheaper_and_finer_again(tiered_bundle):
    avatar = AdaptiveAvatar(tiered_bundle, 0.010, tier="int8")
    pose = np.zeros((52, 3), np.float32)
    assert avatar.levels[:4] == [(1, None), (2, None), (4, None), (8, None)]

    def frames(count: int, seconds: float) -> tuple:
        for _ in range(count):
            avatar.gaussians(pose)
            avatar.frame_took(seconds)
        return avatar.levels[avatar.level]

    assert frames(PATIENCE, 0.02) == (2, None)
    assert frames(2, 10.0) == (2, None)  # opening a level is slow, and no reason to go on
    assert frames(100, 0.02) == avatar.levels[-1]  # as cheap as it goes, and no further
    assert frames(RECOVERY, 0.008) == avatar.levels[-1]  # within the budget: nothing changes
    frames(8, 0.002)
    assert frames(RECOVERY, 0.002) == avatar.levels[-2]
    assert frames(500, 0.002) == (1, None)
    assert frames(PATIENCE - 1, 0.008) == frames(1, 5.0) == (1, None)  # one slow frame alone
    assert frames(20, 0.0099) == (1, None)  # and it is not carried along
    assert sum(level["frames"] for level in avatar.report()) == 2 * PATIENCE + 2 + 100 + 2 * RECOVERY + 8 + 500 + 20
    assert frames(PATIENCE, 0.05) == (4, None)  # far over: two levels at once
    with pytest.raises(UserError, match="budget of 0 ms"):
        AdaptiveAvatar(tiered_bundle, 0.0)
    assert {r for r, _ in AdaptiveAvatar(tiered_bundle, 1.0, tier="baked").levels} == {1}  # nothing to reuse


def test_the_player_keeps_a_budget_and_says_what_it_did(tiered_bundle, tmp_path, capsys):
    from gavatar_runtime.cli.play import main

    report = tmp_path / "r.json"
    options = [
        "--tier",
        "blendshape",
        "--size",
        "48",
        "--frames",
        "0:12",
        "--out",
        str(tmp_path / "f"),
        "--json",
        str(report),
    ]
    with pytest.raises(SystemExit) as done:
        main([str(tiered_bundle.path), *options, "--budget-ms", "0.01"])
    assert done.value.code == 0
    assert "budget 0.01 ms:" in capsys.readouterr().out
    levels = json.loads(report.read_text())["levels"]
    assert len(levels) >= 1
    assert sum(level["frames"] for level in levels) == 12
    with pytest.raises(SystemExit) as done:
        main([str(tiered_bundle.path), *options, "--budget-ms", "5", "--reuse", "2"])
    assert done.value.code == 2
    assert "leave --gaussians, --uv, --reuse and --seen-only out" in capsys.readouterr().err
