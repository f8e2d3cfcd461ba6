"""torch's threads in training: as asked for, else within affinity and quota."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch
from children import child_environment
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import check, compose_config
from gavatar.training import trainer
from gavatar.training.trainer import Trainer

COUNT = """
import os, sys
from pathlib import Path
import gavatar_runtime.cpus as cpus
if sys.argv[1]:
    cpus.ROOT = Path(sys.argv[1])
else:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import gavatar
import torch
torch.rand(600, 600) @ torch.rand(600, 600)
print(torch.get_num_threads(), cpus.usable_cpus())
"""


def counted(root: object = "") -> str:
    environment = child_environment()
    environment.pop("OMP_NUM_THREADS", None)
    done = subprocess.run([sys.executable, "-c", COUNT, str(root)], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system has no affinity")
def test_torch_keeps_to_affinity_and_quota(tmp_path):
    assert counted() == "1 1"
    mount = "29 23 0:26 / /sys/fs/cgroup rw - cgroup2 cgroup2 rw\n"
    for name, text in {
        "proc/self/cgroup": "0::/\n",
        "proc/self/mountinfo": mount,
        "sys/fs/cgroup/cpu.max": "1 1\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert counted(tmp_path) == "1 1"


def test_a_trainer_takes_the_threads_asked_for_and_no_more_than_there_are_otherwise(tmp_path, monkeypatch):
    before = torch.get_num_threads()
    monkeypatch.setattr(trainer, "usable_cpus", lambda: 2)
    try:
        for asked, started, taken in ((3, 5, 3), (0, 5, 2), (0, 1, 1)):
            torch.set_num_threads(started)
            capture = write_tiny_capture(tmp_path / f"capture{asked}{started}")
            given = [f"capture={capture}", f"out={tmp_path / 'run'}", *SMALL, f"threads={asked}"]
            Trainer(check(compose_config(given)), tmp_path)
            assert torch.get_num_threads() == taken
    finally:
        torch.set_num_threads(before)
