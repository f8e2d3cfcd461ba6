"""Running commands in this process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from gavatar_runtime.cli import motion_files, play


def run_motion(*arguments: Any) -> int:
    """The exit code of `gavatar-motion` with those arguments."""
    return _exit_code(motion_files.main, arguments)


def run_play(*arguments: Any) -> int:
    """The exit code of `gavatar-play` with those arguments."""
    return _exit_code(play.main, arguments)


def run_prepare(*arguments: Any) -> int:
    """The exit code of `gavatar-prepare` with those arguments."""
    from gavatar.cli import prepare  # needs what trains, which tests of the player do without

    return _exit_code(prepare.main, arguments)


def _exit_code(main: Callable, arguments: tuple[Any, ...]) -> int:
    with pytest.raises(SystemExit) as done:
        main([str(argument) for argument in arguments])
    return done.value.code
