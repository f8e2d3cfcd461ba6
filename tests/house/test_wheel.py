"""The wheel of a clean clone: what it carries, as a player without torch, and with the training extras."""

from __future__ import annotations

import configparser
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from fetched_wheels import OFFLINE
from places import ROOT

RUNTIME_COMMANDS = {"gavatar-convert", "gavatar-view", "gavatar-play", "gavatar-motion", "gavatar-list"}
NEEDS_TRAINING = "pip install 'gavatar[train]'"


def run(*command: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess:
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    environment |= {"OMP_NUM_THREADS": "1", "PYTHONNOUSERSITE": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    return subprocess.run([str(c) for c in command], capture_output=True, text=True, cwd=cwd, env=environment)


def succeed(*command: str | Path, cwd: Path | None = None) -> str:
    done = run(*command, cwd=cwd)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


# The layout that pyproject.toml lists


def test_pyproject_lists_every_folder_that_holds_a_module():
    tomllib = pytest.importorskip("tomllib")
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = set()
    for name, folder in setuptools["package-dir"].items():
        base = ROOT / folder
        homes = {path.parent.relative_to(base) for path in base.rglob("*.py")}
        found |= {".".join((name, *home.parts)) for home in homes}
    assert found == set(setuptools["packages"])


# The wheel


@pytest.fixture(scope="module")
def clone(tmp_path_factory) -> Path:
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("needs git and a git checkout")
    folder = tmp_path_factory.mktemp("wheel") / "clone"
    succeed("git", "clone", "--quiet", "--depth", "1", f"file://{ROOT}", folder)
    return folder


@pytest.fixture(scope="module")
def wheel(clone) -> Path:
    pytest.importorskip("setuptools")
    dist = clone.parent / "dist"
    succeed(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", dist, clone)
    (path,) = dist.glob("gavatar-*.whl")
    return path


@pytest.fixture(scope="module")
def members(wheel) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.fixture(scope="module")
def commands(wheel) -> list[str]:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith("dist-info/entry_points.txt")]
        parser = configparser.ConfigParser()
        parser.read_string(archive.read(name).decode())
    return sorted(parser["console_scripts"])


@pytest.mark.slow
def test_the_wheel_carries_modules_presets_plugins_body_and_demo_capture(clone, members):
    for folder, package in (
        ("gavatar", "gavatar"),
        ("gavatar_plugins",) * 2,
        ("deploy/gavatar_runtime", "gavatar_runtime"),
    ):
        base = clone / folder
        shipped = [p for p in base.rglob("*") if p.suffix in (".py", ".npz", ".typed")]
        owed = {f"{package}/{p.relative_to(base).as_posix()}" for p in shipped}
        assert owed <= members
    owed = {f"gavatar/conf/{p.relative_to(clone / 'conf').as_posix()}" for p in (clone / "conf").rglob("*.yaml")}
    assert owed
    assert owed <= members
    demo = clone / "gavatar" / "data"
    owed = {f"gavatar/data/{p.relative_to(demo).as_posix()}" for p in demo.rglob("*") if p.is_file()}
    assert {"gavatar/data/studio_demo/capture.json", "gavatar/data/body/gavatar_body_smplh.npz"} <= owed
    assert owed <= members


@pytest.mark.slow
def test_the_wheel_leaves_the_namespace_open_and_carries_licence_and_notice(members):
    assert "gavatar_plugins/__init__.py" not in members
    assert {name.rsplit("/", 1)[-1] for name in members if ".dist-info/licenses/" in name} == {"LICENSE", "NOTICE"}
    assert {name.split("/")[0].split("-")[0] for name in members} == {"gavatar", "gavatar_plugins", "gavatar_runtime"}


# The player: a base install, no torch


@pytest.fixture(scope="module")
def player(clone, wheel) -> Path:
    """bin/ of an environment that holds the wheel and the dependencies of its base install."""
    environment = clone.parent / "player"
    succeed(sys.executable, "-m", "venv", "--without-pip", environment)
    pip = [sys.executable, "-m", "pip", "--python", environment / "bin" / "python", "install", "-q"]
    done = run(*pip, "-c", ROOT / "constraints.txt", wheel)
    if done.returncode and any(sign in done.stderr for sign in OFFLINE):
        pytest.skip("the base install's dependencies cannot be fetched: no package index within reach")
    assert done.returncode == 0, done.stderr
    return environment / "bin"


@pytest.mark.slow
def test_the_base_install_is_numpy_onnxruntime_and_what_that_needs_under_250_megabytes(player, tmp_path):
    script = "import importlib.metadata as m; print(*sorted(d.metadata['Name'].lower() for d in m.distributions()))"
    installed = set(succeed(player / "python", "-c", script, cwd=tmp_path).split())
    assert installed >= {"gavatar", "numpy", "onnxruntime"}
    assert installed <= {"gavatar", "numpy", "onnxruntime", "flatbuffers", "protobuf", "packaging"}
    (site,) = player.parent.glob("lib/python*/site-packages")
    size = sum(path.stat().st_size for path in site.rglob("*") if path.is_file())
    assert size < 250e6, f"{size / 1e6:.0f} MB"


@pytest.mark.slow
def test_runtime_commands_print_their_help_without_torch(player, commands, tmp_path):
    assert set(commands) >= RUNTIME_COMMANDS
    for command in sorted(RUNTIME_COMMANDS):
        assert command in succeed(player / command, "--help", cwd=tmp_path)


@pytest.mark.slow
def test_training_commands_say_in_one_sentence_which_extra_they_need(player, commands, tmp_path):
    for command in sorted(set(commands) - RUNTIME_COMMANDS):
        done = run(player / command, "capture=x", cwd=tmp_path)
        assert done.returncode == 2, f"{command}: {done.stderr}"
        assert done.stderr.count("\n") == 1, f"{command}: {done.stderr}"
        assert NEEDS_TRAINING in done.stderr, f"{command}: {done.stderr}"
        help_ = run(player / command, "--help", cwd=tmp_path)
        assert help_.returncode in (0, 2), f"{command}: {help_.stderr}"
        assert "Traceback" not in help_.stderr


@pytest.mark.slow
def test_the_list_works_without_torch_and_names_the_extra(player, tmp_path):
    done = run(player / "gavatar-list", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert f"available after {NEEDS_TRAINING}:" in done.stdout
    assert "gavatar_plugins.decoders.mlp" in done.stdout
    assert "failed to import" not in done.stdout


@pytest.mark.slow
def test_a_bundle_plays_without_torch(player, tmp_path):
    pytest.importorskip("onnx")
    from make_bundle import make_bundle

    bundle = tmp_path / "tiny.gavatar"
    make_bundle(bundle)
    arguments = ["--motion", "wave", "--frames", "0:2", "--size", "64", "--out", tmp_path / "sheet.png"]
    out = succeed(player / "gavatar-play", bundle, *arguments, cwd=tmp_path)
    assert (tmp_path / "sheet.png").stat().st_size > 0
    assert "sheet.png" in out
    succeed(player / "gavatar-play", bundle, *arguments[:-1], tmp_path / "frames", cwd=tmp_path)
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == ["000000.png", "000001.png"]


# The training extras


@pytest.fixture(scope="module")
def trainer(clone, wheel) -> Path:
    """bin/ of an environment with the wheel's gavatar that borrows every other package from the running one."""
    for module in ("torch", "hydra"):
        pytest.importorskip(module)
    environment = clone.parent / "trainer"
    succeed(sys.executable, "-m", "venv", "--without-pip", environment)
    (site,) = environment.glob("lib/python*/site-packages")
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", environment / "bin" / "python", "install", "-q"]
    succeed(*pip, "--no-deps", "--no-index", "--ignore-installed", wheel)
    return environment / "bin"


@pytest.mark.slow
def test_every_console_command_prints_its_help(trainer, commands, tmp_path):
    assert len(commands) >= 7
    for command in commands:
        assert command in succeed(trainer / command, "--help", cwd=tmp_path)


@pytest.mark.slow
def test_presets_body_and_demo_capture_are_found_in_the_installed_package(trainer, tmp_path):
    script = f"""
import importlib.resources, pathlib, sys
import gavatar, gavatar_runtime
assert pathlib.Path(gavatar.__file__).is_relative_to({str(trainer.parent)!r}), gavatar.__file__
assert pathlib.Path(gavatar_runtime.__file__).is_relative_to({str(trainer.parent)!r}), gavatar_runtime.__file__
from gavatar.capture.opening import open_capture
from gavatar.config import register_configs
from gavatar.registry import BODIES
register_configs()
print(open_capture(importlib.resources.files("gavatar.data") / "studio_demo").name)
print(len(BODIES.build("free").data.v_template))
"""
    assert succeed(trainer / "python", "-c", script, cwd=tmp_path).split() == ["studio_demo", "12700"]
    presets = {path.stem for path in (ROOT / "conf" / "experiment").glob("*.yaml")}
    assert {"demo", "default", "paper", "upstream"} <= presets
    for preset in ("demo", "paper"):
        arguments = ["--cfg", "job", "capture=x", f"experiment={preset}"]
        assert "stage1:" in succeed(trainer / "gavatar-train", *arguments, cwd=tmp_path)
