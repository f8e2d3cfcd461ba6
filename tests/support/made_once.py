"""What takes long to make and serves many tests: made by the first of pytest's processes that wants it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

LONGEST = 600  # seconds to wait for another process


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that `make(folder)` has filled, one for all processes of a test run; if it failed, for all."""
    base = factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder, done = base / name, base / f"{name}.done"
    try:
        folder.mkdir()
    except FileExistsError:
        end = time.monotonic() + LONGEST
        while not done.exists() and time.monotonic() < end:
            time.sleep(0.1)
    else:
        verdict = "failed in another process"
        try:
            make(folder)
            verdict = ""
        finally:
            done.write_text(verdict)
    if not done.exists() or done.read_text():
        pytest.fail(f"{name}: {done.read_text() if done.exists() else 'was not made in time'}")
    return folder
