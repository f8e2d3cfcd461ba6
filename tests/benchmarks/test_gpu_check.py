"""What `benchmarks/gpu_check.py` measures on CUDA runs on the CPU as well, at a tiny size."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from places import ROOT, SUPPORT
from tiny_capture import write_tiny_capture


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


@pytest.mark.parametrize("part", ["timings", "agreement", "playback"])
def test_a_part_runs_on_the_cpu(part, capture):
    command = [sys.executable, str(ROOT / "benchmarks" / "gpu_check.py"), "--only", part, "--device", "cpu", "--quick"]
    done = subprocess.run([*command, "--capture", str(capture)], capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": str(SUPPORT)}, timeout=300)  # fmt: skip
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert done.returncode == 0, done.stderr
    assert rows
    for row in rows:
        if part == "agreement" and row["clamp"] == 0.99:
            assert row["psnr_db"] > 80  # float32 beside float32 of the same rule: as tests/plugins/rasterizers
        if part == "timings":
            assert 0 < row["forward_ms"] < row["forward_backward_ms"]
        if part == "playback":
            assert row["frame_ms"] > 0
            assert row["dynamic"]
