"""Wheels that cannot be installed beside what the project needs, fetched for what lies inside."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from made_once import made_once

# what pip says where no package index is within reach
OFFLINE = ("NewConnectionError", "ConnectTimeout", "Temporary failure in name resolution", "from versions: none")


def fetched_wheel(factory: pytest.TempPathFactory, requirement: str, under: str) -> Path:
    """A folder with those files of the wheel that `requirement` pins (`name==version`) whose paths start with `under`;
    none of its dependencies comes with it. Skips where no package index is within reach."""
    name = requirement.partition("==")[0]

    def make(folder: Path) -> None:
        # one platform's wheel for all: it is not its compiled code that is wanted
        built_for = ["--only-binary", ":all:", "--python-version", "3.11", "--platform", "manylinux_2_28_x86_64"]
        pip = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "-q",
            "--no-deps",
            "--timeout",
            "20",
            "--retries",
            "1",
            *built_for,
        ]
        done = subprocess.run([*pip, "-d", folder, requirement], capture_output=True, text=True, timeout=300)
        if done.returncode:
            (folder / "error.txt").write_text(done.stderr)
            return
        (wheel,) = folder.glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder, [member for member in archive.namelist() if member.startswith(under)])
        wheel.unlink()

    folder = made_once(factory, f"wheel-{name}", make)
    if (folder / "error.txt").exists():
        error = (folder / "error.txt").read_text()
        assert any(sign in error for sign in OFFLINE), error
        pytest.skip(f"{requirement} cannot be fetched: no package index within reach")
    return folder
