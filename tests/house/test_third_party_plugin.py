"""A component from another distribution: installed with pip, listed with its origin, selected by an override."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from places import ROOT, SUPPORT

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.motions import read_motion

EXAMPLE = SUPPORT / "plugin_example"
DEMO = ROOT / "gavatar" / "data" / "studio_demo"
LEVELS = "[{until:1.0,gaussians:2850,image:0.25}]"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder that holds the example distribution, as pip installs it."""
    pytest.importorskip("setuptools")
    base = tmp_path_factory.mktemp("plugin")
    source = shutil.copytree(EXAMPLE, base / "source")  # a build leaves files beside pyproject.toml
    target = base / "site"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index"]
    command += ["--no-deps", "--no-build-isolation", "--target", str(target), str(source)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return target


def run(installed: Path, module: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess:
    environment = {**os.environ, "PYTHONPATH": str(installed), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, "-m", module, *arguments], capture_output=True, text=True, cwd=cwd, env=environment
    )


def test_the_documented_example_is_the_tested_one():
    blocks = (ROOT / "docs" / "guide" / "your_own_component.md").read_text().split("```")[1::2]
    shown = {"pyproject.toml": [block for block in blocks if block.startswith("toml")]}
    for block in blocks:
        first = block.splitlines()[1]
        if first.startswith("# src/"):
            shown.setdefault(first.removeprefix("# "), []).append(block)
    assert len(shown) == 4
    for path, parts in shown.items():
        tested = (EXAMPLE / path).read_text().splitlines()
        lines = [line for part in parts for line in part.splitlines()[1:] if not line.startswith("# ")]
        assert [line for line in lines if line not in tested] == []


def test_the_list_names_the_distribution_and_reports_the_broken_sibling(installed, tmp_path):
    done = run(installed, "gavatar.cli.list", "decoder", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    listing = json.loads(done.stdout)
    rows = {row["name"]: row for row in listing["groups"]["decoder"]}
    assert rows["tinydecoder"]["distribution"] == "gavatar-tinydecoder 0.3.0"
    assert rows["tinydecoder"]["origin"] == "gavatar_tinydecoder.decoder"
    assert rows["tinydecoder"]["options"][0] == {"name": "width", "type": "int", "default": 16, "required": False}
    assert rows["mlp"]["distribution"].startswith("gavatar ")
    (failure,) = [f for f in listing["failures"] if "tinydecoder" in f["plugin"]]
    assert failure["plugin"].startswith("broken (gavatar_tinydecoder.broken")
    assert failure["cause"] == "RuntimeError: this plugin is broken on purpose"


def test_an_override_selects_it_and_its_options_compose(installed, tmp_path):
    overrides = [f"capture={DEMO}", "decoder=tinydecoder", "decoder.width=8"]
    done = run(installed, "gavatar.cli.train", "--cfg", "job", "--package", "decoder", *overrides, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-3:] == ["name: tinydecoder", "width: 8", "reach: 0.05"]


def test_an_unknown_option_of_it_is_one_sentence(installed, tmp_path):
    overrides = [f"capture={DEMO}", "decoder=tinydecoder", "decoder.widht=8"]
    done = run(installed, "gavatar.cli.train", *overrides, cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "widht" in done.stderr


def test_it_trains(installed, tmp_path):
    overrides = [f"capture={DEMO}", f"out={tmp_path / 'run'}", "decoder=tinydecoder", "decoder.width=8", "encoder=none"]
    overrides += ["stage1.steps=2", "stage1.batch=1", f"stage1.levels={LEVELS}", "losses={l1:1.0}", "progress=false"]
    done = run(installed, "gavatar.cli.train", *overrides, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "name: tinydecoder" in (tmp_path / "run" / "config.yaml").read_text()
    assert (tmp_path / "run" / "metrics.json").exists()


def test_its_output_is_listed_with_its_options(installed, tmp_path):
    done = run(installed, "gavatar.cli.list", "output", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    rows = {row["name"]: row for row in json.loads(done.stdout)["groups"]["output"]}
    assert {"video", "frames", "sheet", "ply", "points"} <= set(rows)
    assert rows["points"]["distribution"] == "gavatar-tinydecoder 0.3.0"
    assert rows["points"]["options"] == [{"name": "digits", "type": "int", "default": 4, "required": False}]


def test_its_output_is_chosen_by_the_suffix(installed, tmp_path):
    pytest.importorskip("onnx", reason="the hand-made networks need onnx")
    from make_bundle import make_bundle

    bundle = make_bundle(tmp_path / "a.gavatar", 20)
    common = ["gavatar_runtime.cli.play", str(bundle), "--quiet", "--frames", "0:2"]
    done = run(installed, *common, "--out", "a.xyz", "--set", "output.digits=2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    points = np.loadtxt(tmp_path / "a.xyz")
    avatar = Avatar(bundle)
    motion, _ = avatar.fit(read_motion("turn"))
    wanted = avatar.gaussians(*motion.at(0))
    np.testing.assert_allclose(points[:, :3], wanted.means, atol=0.0051)  # two digits
    np.testing.assert_allclose(points[:, 3:], 255 * wanted.colors, atol=0.5001)
    done = run(installed, *common, "--out", "f/%02d.xyz", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (tmp_path / "f").iterdir()) == ["00.xyz", "01.xyz"]
    done = run(installed, *common, "--out", "a.xyy", cwd=tmp_path)
    assert done.returncode == 2
    assert "did you mean '.xyz'" in done.stderr
