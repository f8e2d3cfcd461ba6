"""The programs that the guide gives to clusters, run as they are: two launchers, a job that is killed, one table."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from places import ROOT
from tiny_capture import SMALL, write_tiny_capture

QUICK = [o for o in SMALL if not o.startswith(("encoder", "stage", "checkpoint", "dynamics"))] + [
    "encoder=none", "stage1.steps=12", "stage1.batch=2", "stage1.levels=[{until:1.0,uv:64,image:0.125}]",
    "checkpoint_every=2",
]  # fmt: skip
PROGRAMS = {"submitit": "09_many_on_slurm.py", "ray": "10_many_on_ray.py"}
PATIENCE = 240  # seconds, on a machine that does other things too


@pytest.fixture
def place(tmp_path) -> Path:
    for name in "ab":
        write_tiny_capture(tmp_path / "captures" / name)
    return tmp_path


def begin(package: str, place: Path) -> subprocess.Popen:
    pytest.importorskip(package, reason=f"needs {package}: pip install {package}")
    environment = os.environ | {"OMP_NUM_THREADS": "1", "RAY_USAGE_STATS_ENABLED": "0"}
    environment.pop("RAY_ADDRESS", None)
    command = [sys.executable, str(ROOT / "examples" / PROGRAMS[package]), "runs", "captures/*", *QUICK]
    return subprocess.Popen(
        command, cwd=place, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )


def training_of(run: str, program: subprocess.Popen) -> int:
    """The process that trains `run` and has written a checkpoint."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        assert program.poll() is None, program.stdout.read()
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                words = (folder / "cmdline").read_bytes().split(b"\0")
                here = Path(os.readlink(folder / "cwd"))
            except OSError:
                continue
            if f"out={run}".encode() in words and (here / run / "checkpoint.pt").exists():
                return int(folder.name)
        time.sleep(0.02)
    raise AssertionError("no training was seen")


def check_continued(log: str) -> None:
    """The job went on from the checkpoint that the killed process left, and made the rest of the steps only."""
    (step,) = re.findall(r"runs/a goes on from its checkpoint, at step (\d+) of 12 in stage 1", log)
    assert 2 <= int(step) < 12


def check_table(place: Path) -> None:
    rows = json.loads((place / "runs/comparison.json").read_text())
    assert [row["run"] for row in rows] == ["a"] * 3 + ["b"] * 3
    page = (place / "runs/comparison.html").read_text()
    assert page.count("<img ") == 6
    assert "Without a result" not in page
    for name in "ab":
        assert json.loads((place / f"runs/{name}/metrics.json").read_text())["finished"]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="finds the job's process in /proc")
def test_a_job_killed_on_slurm_is_named_and_the_same_command_continues_it(place):
    program = begin("submitit", place)
    os.kill(training_of("runs/a", program), signal.SIGKILL)
    said = program.communicate(timeout=PATIENCE)[0]
    assert program.returncode != 0, said
    assert "captures/a: exit code -9" in said
    assert "captures/b: exit code 0" in said
    assert "error: runs/a: runs/a has no finished stage yet" in said
    done = json.loads((place / "runs/b/metrics.json").read_text())
    again = begin("submitit", place)
    said = again.communicate(timeout=PATIENCE)[0]
    assert again.returncode == 0, said
    check_table(place)
    assert json.loads((place / "runs/b/metrics.json").read_text()) == done  # what was finished was kept
    check_continued("".join(path.read_text() for path in sorted((place / "runs/jobs").glob("*_0_log.err"))))


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="finds the job's process in /proc")
def test_a_job_killed_on_ray_is_begun_again_by_itself_and_continues(place):
    program = begin("ray", place)
    killed = training_of("runs/a", program)
    os.kill(killed, signal.SIGKILL)
    said = program.communicate(timeout=PATIENCE)[0]
    assert program.returncode == 0, said
    check_table(place)
    check_continued((place / "runs/jobs/a.log").read_text())
