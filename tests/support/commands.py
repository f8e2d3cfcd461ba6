"""Running the commands of the runtime in this process."""

from __future__ import annotations

from typing import Any

import pytest

from gavatar_runtime.cli.motion_files import main


def run_motion(*arguments: Any) -> int:
    """The exit code of `gavatar-motion` with those arguments."""
    with pytest.raises(SystemExit) as done:
        main([str(argument) for argument in arguments])
    return done.value.code
