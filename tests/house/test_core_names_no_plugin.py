"""The core names no component and no option of one: it asks the registry what a component can.

The core is both halves without the rooms whose modules register components, and without the demonstration, which is a
programme for one capture, one preset and two motions.
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import ROOT

from gavatar.registry import REGISTRIES, load_plugins
from gavatar_runtime.components import Registry
from gavatar_runtime.motions import MOTIONS
from gavatar_runtime.render.choice import player_rasterizers
from gavatar_runtime.tiers import player_tiers

RUNTIME, LIBRARY = ROOT / "deploy" / "gavatar_runtime", ROOT / "gavatar"
ROOMS = (RUNTIME / "motions", RUNTIME / "tiers", RUNTIME / "render" / "rasterizers", RUNTIME / "play" / "outputs")
ROOMS = (*ROOMS, RUNTIME / "conversions")
NO_CORE = (*ROOMS, LIBRARY / "demo.py")
GROUPS = {registry.group for registry in REGISTRIES}

PROJECT = {"gavatar", "run"}  # its own name, which its capture layout has too; what training writes, and a motion
FAMILIES = {"smpl", "smplh", "smplx"}  # of body models: what files, motions and captures say that they are of
AUTO = "the word for an option that decides by itself"
# words that mean something else where they stand, and what
WORDS = {
    ("gavatar/capture/reading.py", "none"): "there is no field",
    ("gavatar/cli/prepare.py", "landmarks"): "an option: a file of points of the body",
    ("gavatar/config.py", "auto"): AUTO,
    ("gavatar/assemble.py", "auto"): AUTO,
    ("gavatar/evaluation/comparison.py", "perceptual"): "the metric",
    ("gavatar/evaluation/comparison.py", "ssim"): "the metric",
    ("gavatar/evaluation/result.py", "perceptual"): "the metric",
    ("gavatar/evaluation/result.py", "ssim"): "the metric",
    ("gavatar/export/distillation.py", "turn"): "an array of blendshape.npz",
    ("gavatar/face.py", "auto"): "the tiers that pay",
    ("gavatar/images/lpips.py", "lpips"): "the package that has the weights",
    ("gavatar/images/lpips.py", "scale"): "a buffer of the network",
    ("gavatar/images/metrics.py", "ssim"): "the metric",
    ("gavatar/measure/ladder.py", "full"): "what a choice is compared with",
    ("gavatar/measure/ladder_report.py", "none"): "no fill, to matplotlib",
    ("gavatar/measure/ladder_report.py", "perceptual"): "the metric",
    ("gavatar/optional.py", "gsplat"): "the package",
    ("gavatar/optional.py", "torch"): "the package",
    ("gavatar/optional.py", "video"): "the extra",
    ("gavatar/preparation/footage_source.py", "frames"): "a folder of footage",
    ("gavatar/preparation/footage_source.py", "video"): "a kind of footage",
    ("gavatar/preparation/fit.py", "offset"): "a term of the fit",
    ("gavatar/training/plan.py", "auto"): AUTO,
    ("gavatar/training/precision.py", "auto"): AUTO,
    ("deploy/gavatar_runtime/avatar/adaptive.py", "frames"): "how many were played",
    ("deploy/gavatar_runtime/cli/motion_files.py", "frames"): "of a motion",
    ("deploy/gavatar_runtime/cli/play.py", "json"): "an argument",
    ("deploy/gavatar_runtime/cli/play_report.py", "frames"): "how many were played",
    ("deploy/gavatar_runtime/live/following.py", "idle"): "a state",
    ("deploy/gavatar_runtime/formats/bvh_file.py", "frames"): "a word of the format",
    ("deploy/gavatar_runtime/formats/pickled_values.py", "numpy"): "the package",
    ("deploy/gavatar_runtime/formats/torch_file.py", "torch"): "the package",
}


def names_of(*registries: Registry) -> set[str]:
    return {component.name for registry in registries for component in registry if shipped(component.origin)}


def shipped(module: str) -> bool:
    return module.partition(".")[0] in ("gavatar", "gavatar_plugins", "gavatar_runtime")


@pytest.fixture(scope="module")
def names() -> dict[Path, set[str]]:
    """What each half may not name: the player knows nothing of what only training has."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        load_plugins()
    of_player = names_of(MOTIONS, player_tiers(), player_rasterizers())
    return {RUNTIME: of_player, LIBRARY: of_player | names_of(*REGISTRIES)}


def core(home: Path) -> Iterator[Path]:
    for path in sorted(home.rglob("*.py")):
        if not any(path == part or part in path.parents for part in NO_CORE):
            yield path


def constants(source: str) -> Iterator[tuple[int, str]]:
    """(line, value) of every string constant; parts of f-strings are texts."""
    tree = ast.parse(source)
    texts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in texts:
            yield node.lineno, node.value


def options_read(source: str) -> Iterator[tuple[int, str]]:
    """(line, expression) where something of a component's node is looked up beside its name: config.decoder["width"],
    config.decoder.get("width")."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Subscript):
            base, key = node.value, node.slice
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args:
            base, key = node.func.value, node.args[0]
        else:
            continue
        of_config = isinstance(base, ast.Attribute) and ast.unparse(base.value).split(".")[-1] == "config"
        if of_config and base.attr in GROUPS and isinstance(key, ast.Constant) and key.value != "name":
            yield node.lineno, ast.unparse(node)


@pytest.mark.parametrize("home", [RUNTIME, LIBRARY], ids=["runtime", "library"])
def test_the_core_names_no_component(names, home):
    found, named = set(), []
    for path in core(home):
        for line, value in constants(path.read_text()):
            if value in names[home] - PROJECT - FAMILIES:
                place = (path.relative_to(ROOT).as_posix(), value)
                found.add(place)
                named += [] if place in WORDS else [f"{place[0]}:{line} names '{value}'"]
    assert named == []
    listed = {place for place in WORDS if home in (ROOT / place[0]).parents}
    assert listed - found == set(), "words that no longer stand there"


@pytest.mark.parametrize("home", [RUNTIME, LIBRARY], ids=["runtime", "library"])
def test_the_core_looks_up_no_option_of_a_component(home):
    found = [f"{path}:{line} {text}" for path in core(home) for line, text in options_read(path.read_text())]
    assert found == []


def test_the_check_itself_notices_names_and_options():
    found = {value for _, value in constants('x = {"name": "mlp"} if y == "unet" else f"native{z}"')}
    assert found == {"name", "mlp", "unet"}
    for source in ('config.decoder["width"]', 'run.config.rasterizer.get("fast", 1)', 'self.config.body.pop("path")'):
        assert list(options_read(source)), source
    for source in ('config.decoder["name"]', 'manifest.body["model"]', "split_node(config.decoder)"):
        assert not list(options_read(source)), source
