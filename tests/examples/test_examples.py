"""Every program of examples/ runs as its first line says, and stays short."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))
LONGEST = 40  # lines: a program that is read at one look
SHORT = ("stage1.steps=3", "progress=false")


def run(name: str, *arguments: str | Path) -> str:
    (script,) = (ROOT / "examples").glob(f"{name}_*.py")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def bundle(tmp_path_factory) -> Path:
    pytest.importorskip("onnx")
    from make_bundle import make_bundle

    path = tmp_path_factory.mktemp("bundle") / "tiny.gavatar"
    make_bundle(path)
    return path


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    from tiny_capture import write_tiny_capture

    return write_tiny_capture(tmp_path_factory.mktemp("capture"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_is_short_and_says_how_it_is_run(path):
    lines = path.read_text().splitlines()
    assert len(lines) < LONGEST
    assert "python examples/" in lines[0]


def test_a_first_frame(bundle, tmp_path):
    assert "300 Gaussians" in run("01", bundle, tmp_path / "frame.png")
    assert (tmp_path / "frame.png").read_bytes().startswith(b"\x89PNG")


def test_a_contact_sheet_where_a_video_may_not_be_written(bundle, tmp_path):
    run("02", bundle, "wave", tmp_path / "wave.png")
    assert (tmp_path / "wave.png").stat().st_size > 0


def test_gaussians_for_other_programs(bundle, tmp_path):
    assert "Gaussians" in run("03", bundle, tmp_path / "one.ply")
    assert (tmp_path / "one.ply").read_bytes().startswith(b"ply\n")


def test_a_motion_of_ones_own(bundle, tmp_path):
    run("04", bundle, tmp_path / "salute.png")
    assert (tmp_path / "salute.png").stat().st_size > 0


def test_every_stored_tier_is_drawn(bundle, tmp_path):
    assert "full: 0.000 rms" in run("05", bundle, tmp_path / "tiers")
    assert (tmp_path / "tiers" / "full.png").exists()


def test_training_evaluating_and_exporting(capture, tmp_path):
    assert "TrainedRun" in run("06", capture, tmp_path / "run", *SHORT)
    assert "dB" in run("07", tmp_path / "run", tmp_path / "person.gavatar")
    assert (tmp_path / "person.gavatar").stat().st_size > 0


def test_a_decoder_of_ones_own(capture, tmp_path):
    assert "TrainedRun" in run("08", capture, tmp_path / "run", *SHORT)


def test_the_notebook_runs(bundle, tmp_path, monkeypatch):
    """Its code cells one after another in one namespace, as a kernel does."""
    import json

    cells = json.loads((ROOT / "examples" / "avatar.ipynb").read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GAVATAR_EXAMPLE_BUNDLE", str(bundle))
    names: dict = {}
    for source in code:
        exec(compile(source, "avatar.ipynb", "exec"), names)
    assert names["image"].ndim == 3
