"""Of warnings a command shows the project's own, one line each, and none that its users cannot act on."""

from __future__ import annotations

import logging
import subprocess
import sys
import warnings

import pytest

from gavatar_runtime.errors import UserError, exit_cleanly
from gavatar_runtime.notes import Note, notes_only


def python(script: str, *options: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, *options, "-c", script], capture_output=True, text=True)


@exit_cleanly
def command(fails: bool = False) -> None:
    """Warns in every way that code of others does, and in ours."""
    warnings.warn("the hands do not move", Note)
    warnings.warn("this will be an error in version 7", FutureWarning)
    warnings.warn("casting complex to real", UserWarning)
    warnings.warn("overflow in exp", RuntimeWarning)
    logging.getLogger("fonts").warning("building the cache")
    logging.getLogger("gavatar.training").warning("dynamics are not worth their cost")
    if fails:
        raise UserError("nothing there")


def test_a_command_shows_notes_as_lines(capsys):
    with pytest.raises(SystemExit) as done:
        command()
    assert done.value.code == 0
    assert capsys.readouterr().err == "note: the hands do not move\n"  # pytest has taken the loggers


def test_loggers_of_the_project_are_heard_and_others_are_not():
    done = python(
        "import logging; from gavatar_runtime.notes import notes_only\n"
        "with notes_only():\n"
        "    logging.getLogger('fonts').warning('building the cache')\n"
        "    logging.getLogger('gavatar.training').warning('dynamics are not worth their cost')\n"
    )
    assert done.stderr == "note: dynamics are not worth their cost\n"


def test_nothing_of_it_is_left_behind_even_after_a_mistake(capsys):
    shown, filters, last = warnings.showwarning, list(warnings.filters), logging.lastResort
    with pytest.raises(SystemExit):
        command(fails=True)
    assert capsys.readouterr().err.endswith("error: nothing there\n")
    assert (warnings.showwarning, warnings.filters, logging.lastResort) == (shown, filters, last)


def test_a_note_is_a_warning_of_python_elsewhere():
    with pytest.warns(UserWarning, match="the hands"):
        warnings.warn("the hands do not move", Note)


def test_all_is_shown_when_python_was_asked_for_it():
    script = (
        "import warnings; from gavatar_runtime.errors import exit_cleanly\n"
        "@exit_cleanly\n"
        "def command(): warnings.warn('in version 7', FutureWarning)\n"
        "command()"
    )
    for options, said in ((["-W", "always"], "FutureWarning: in version 7"), ([], "")):
        done = python(script, *options)
        assert said in done.stderr
        assert bool(done.stderr) == bool(said)


def test_a_note_that_is_repeated_at_its_place_is_said_once(capsys):
    with notes_only():
        for _ in range(3):
            warnings.warn("the hands do not move", Note)
    assert capsys.readouterr().err.count("note: ") == 1
