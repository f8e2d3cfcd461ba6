"""`--set KEY=VALUE`, and options in messages as they are written on a command."""

from __future__ import annotations

import pytest

from gavatar_runtime.cli.settings import as_flags, as_motion_options, as_settings, parse_settings
from gavatar_runtime.errors import MissingFile, UserError, options_spelled, spelled


def test_settings_go_to_their_group():
    settings = [
        "motion.waves=3",
        "motion.seconds=1.5",
        "rasterizer.fast=true",
        "motion.up=z",
        "motion.mapping=a=b",
        "output.shown=6",
    ]
    assert parse_settings(settings) == {
        "motion": {"waves": 3, "seconds": 1.5, "up": "z", "mapping": "a=b"},
        "rasterizer": {"fast": True},
        "output": {"shown": 6},
    }
    assert parse_settings([]) == {"motion": {}, "rasterizer": {}, "output": {}}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("waves=3", r"--set waves=3: expected motion\.KEY=VALUE or rasterizer\.KEY=VALUE or output\.KEY=VALUE"),
        ("motion.waves", r"--set motion\.waves: expected motion\.KEY=VALUE"),
        ("motion.=3", r"--set motion\.=3: expected motion\.KEY=VALUE"),
        ("motions.x=1", r"unknown group 'motions'.*did you mean 'motion'"),
    ],
)
def test_a_setting_that_is_none_is_shown_as_it_was_given(setting, message):
    with pytest.raises(UserError, match=message):
        parse_settings([setting])


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


def test_an_option_of_a_motion_is_spelled_as_the_flag_or_the_setting_that_it_has():
    assert spelled("`rest` or `rest=offsets`", as_motion_options) == "--rest or --rest offsets"
    assert spelled("`fps=30`, `mapping`", as_motion_options) == "--set motion.fps=30, --set motion.mapping=VALUE"


def test_an_error_keeps_its_kind_and_all_its_sentences():
    with pytest.raises(MissingFile) as raised, options_spelled(as_settings("")):
        raise MissingFile("`up=q`: choose", "and `fps`")
    assert isinstance(raised.value, FileNotFoundError)
    assert str(raised.value) == "--set up=q: choose"
    assert raised.value.sentences == ("--set up=q: choose", "and --set fps=VALUE")
    with pytest.raises(KeyError, match="`fps`"), options_spelled(as_settings("")):
        raise KeyError("`fps`")
