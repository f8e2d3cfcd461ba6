"""Programs of npm that tests run by node, where both are to be had."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from made_once import made_once

FOLDERS = "GAVATAR_NODE_MODULES"  # folders `node_modules` to look into, before NODE_PATH
WAIT = 180  # seconds for npm, which may have no line to its registry


def node_package(factory: pytest.TempPathFactory, name: str, version: str) -> Path:
    """The folder of a package: one that lies in FOLDERS or NODE_PATH, or else `version` of it, fetched by npm once a
    run. Skips the test, with the reason, where there is no node or npm brings nothing."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    for folder in os.pathsep.join(os.environ.get(v, "") for v in (FOLDERS, "NODE_PATH")).split(os.pathsep):
        if folder and (Path(folder) / name / "package.json").is_file():
            return Path(folder) / name
    if shutil.which("npm") is None:
        pytest.skip(f"{name} lies in none of the folders of {FOLDERS}, and npm is not installed")
    folder = made_once(factory, "npm-" + name.replace("/", "-"), lambda folder: _install(folder, name, version))
    if not (folder / "node_modules" / name / "package.json").is_file():
        pytest.skip(f"npm brings no {name} {version}: {(folder / 'why').read_text()}")
    return folder / "node_modules" / name


def _install(folder: Path, name: str, version: str) -> None:
    command = ["npm", "install", "--silent", "--no-audit", "--no-fund", "--no-save", "--prefix", str(folder)]
    try:
        done = subprocess.run([*command, f"{name}@{version}"], capture_output=True, text=True, timeout=WAIT)
        (folder / "why").write_text((done.stderr or done.stdout).strip()[-300:])
    except (OSError, subprocess.TimeoutExpired) as error:
        (folder / "why").write_text(str(error))


def run_node(*words: str | Path) -> str:
    """What a program of node says; its complaint is the failure."""
    done = subprocess.run(["node", *map(str, words)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr or done.stdout
    return done.stdout
