"""Running a command in the process of the test."""

from __future__ import annotations

from collections.abc import Callable

import pytest


def exit_code(main: Callable, *arguments: object) -> int:
    """What a console entry point ends with."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return ended.value.code
