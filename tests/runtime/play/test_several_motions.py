"""Several motions in a row, by the command and from Python."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import run_play

import gavatar_runtime as gr
from gavatar_runtime.errors import WrongValue
from gavatar_runtime.motions import read_motions

pytestmark = pytest.mark.usefixtures("dots")
SMALL = {"size": 16, "rasterizer": "dots"}


def test_the_command_plays_one_after_another(static, tmp_path):
    options = ("--motion", "jump,wave,idle", "--set", "motion.fps=5", "--blend", "0.6", "--json", tmp_path / "t.json")
    assert run_play(static, "--rasterizer", "dots", "--size", 16, "--out", tmp_path / "a.png", *options) == 0
    report = json.loads((tmp_path / "t.json").read_text())
    assert report["motion"] == "jump_wave_idle"


def test_a_blend_that_cannot_be_is_named_as_the_command_has_it(static, tmp_path, capsys):
    options = ("--motion", "wave,idle", "--blend", "-1", "--out", tmp_path / "a.png")
    assert run_play(static, "--rasterizer", "dots", *options) == 2
    assert "--blend -1" in capsys.readouterr().err


def test_an_avatar_plays_a_list_of_any_skeletons(static, tmp_path):
    np.savez(tmp_path / "m.npz", poses=np.full((4, 72), 0.1), mocap_framerate=10.0)  # SMPL, with hands
    avatar = gr.load(static)
    wave, idle = read_motions(["wave", "idle"], fps=10.0)
    report = avatar.play([wave, tmp_path / "m.npz", idle], tmp_path / "f" / "%d.ply", blend=0.2)
    # the file has four frames and waits for the fifth, which its two blends of two frames want
    assert report.frames == len(wave) + 5 + len(idle) - 4
    assert report.ignored_joints == ("left_hand", "right_hand")
    with pytest.raises(WrongValue, match="blend"):
        avatar.play(["wave", "idle"], tmp_path / "b.png", blend=float("nan"), **SMALL)
