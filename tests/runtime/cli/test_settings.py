"""`--set KEY=VALUE`, and options in messages as they are written on a command."""

from __future__ import annotations

import pytest
from commands import exit_code

from gavatar_runtime.cli.motion_files import main as motion_command
from gavatar_runtime.cli.settings import as_flags, as_settings, parse_options, parse_settings
from gavatar_runtime.errors import MissingFile, UserError, options_spelled, spelled

GROUPS = ("motion", "rasterizer")


def test_settings_go_to_their_group():
    settings = [
        "motion.waves=3",
        "motion.seconds=1.5",
        "rasterizer.fast=true",
        "motion.up=z",
        "motion.mapping=a=b",
    ]
    assert parse_settings(settings, GROUPS) == {
        "motion": {"waves": 3, "seconds": 1.5, "up": "z", "mapping": "a=b"},
        "rasterizer": {"fast": True},
    }
    assert parse_settings([], GROUPS) == {"motion": {}, "rasterizer": {}}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("waves=3", r"--set waves=3: expected motion\.KEY=VALUE or rasterizer\.KEY=VALUE"),
        ("file=a.b", r"--set file=a\.b: expected motion\.KEY=VALUE"),
        ("motion.waves", r"--set motion\.waves: expected motion\.KEY=VALUE"),
        ("motion.=3", r"expected motion\.KEY=VALUE"),
        ("motions.x=1", r"unknown group 'motions'.*did you mean 'motion'"),
    ],
)
def test_a_setting_that_is_none_is_shown_as_it_was_given(setting, message):
    with pytest.raises(UserError, match=message):
        parse_settings([setting], GROUPS)


def test_settings_without_groups():
    assert parse_options(["up=z", "fps=60", "loop=False"]) == {"up": "z", "fps": 60, "loop": False}
    with pytest.raises(UserError, match="--set ups: expected KEY=VALUE"):
        parse_options(["ups"])


@pytest.mark.parametrize(
    ("sentence", "as_said"),
    [
        ("`budget_ms` is too small", "--budget-ms is too small"),
        ("`budget_ms=-0.5`: give more", "--budget-ms -0.5: give more"),
        ("leave `budget_ms` and `uv` out", "leave --budget-ms and --uv out"),
        ("`output.shown=0`: more", "--set output.shown=0: more"),
        ("`wavs` is none of them", "`wavs` is none of them"),
        ("a path with `` and ` in it", "a path with `` and ` in it"),
    ],
)
def test_options_are_spelled_as_flags(sentence, as_said):
    assert spelled(sentence, as_flags({"budget_ms": 1, "uv": None})) == as_said


def test_options_are_spelled_as_settings():
    assert spelled("give `fps`", as_settings("motion.")) == "give --set motion.fps=VALUE"
    assert spelled("`fps=-3`: give more", as_settings("")) == "--set fps=-3: give more"


def test_an_error_keeps_its_kind_and_all_its_sentences():
    with pytest.raises(MissingFile) as raised, options_spelled(as_settings("")):
        raise MissingFile("`up=q`: choose", "and `fps`")
    assert isinstance(raised.value, FileNotFoundError)
    assert str(raised.value) == "--set up=q: choose"
    assert raised.value.sentences == ("--set up=q: choose", "and --set fps=VALUE")
    with pytest.raises(KeyError, match="`fps`"), options_spelled(as_settings("")):
        raise KeyError("`fps`")


def test_the_motion_command_names_options_as_they_are_typed_there(tmp_path, capsys):
    import numpy as np

    np.savez(tmp_path / "a.npz", poses=np.zeros((2, 66)))
    assert exit_code(motion_command, "info", tmp_path / "a.npz") == 2
    assert "'mocap_framerate' is missing; add it or give --set fps=VALUE" in capsys.readouterr().err
    assert exit_code(motion_command, "info", tmp_path / "a.npz", "--set", "fps=-2") == 2
    assert "--set fps=-2 must be one positive number" in capsys.readouterr().err
