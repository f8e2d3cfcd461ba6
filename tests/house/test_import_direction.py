"""Imports run one way, the runtime stays light, and no shipped code can execute what a data file holds."""

from __future__ import annotations

import ast
import functools
import graphlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import ROOT

RUNTIME, LIBRARY, PLUGINS = ROOT / "deploy" / "gavatar_runtime", ROOT / "gavatar", ROOT / "gavatar_plugins"
RUNTIME_MAY_IMPORT = {"numpy", "onnxruntime", "gavatar_runtime"}
# OpenCV is optional there: these try it
MAY_TRY_OPENCV = {RUNTIME / "play" / "outputs" / "video_encoder.py", RUNTIME / "view" / "drive.py"}
MAY_TRY_OPENCV |= {RUNTIME / "live" / name for name in ("sources.py", "camera_pictures.py")}
UNSAFE_MODULES = {"pickle", "cPickle", "dill", "joblib", "shelve", "marshal"}
EXCEPTIONS_OF_PICKLE = {"UnpicklingError", "PickleError"}  # what torch.load raises, even with weights_only=True
# the restricted unpickler itself, which tests/runtime/formats/test_safe_pickle.py attacks
READS_PICKLES = RUNTIME / "formats" / "safe_pickle.py"
# walks the rooms of the namespace package to find what is registered
NAMES_THE_NAMESPACE = LIBRARY / "registry.py"


def sources(*rooms: Path) -> list[Path]:
    return sorted(path for room in rooms for path in room.rglob("*.py"))


def parametrize_files(*rooms: Path):
    return pytest.mark.parametrize("path", sources(*rooms), ids=lambda p: p.relative_to(ROOT).as_posix())


def absolute_name(node: ast.ImportFrom, path: Path) -> str:
    """The module a `from` statement names, relative ones resolved from the file's place."""
    if not node.level:
        return node.module or ""
    home = next(room.parent for room in (RUNTIME, LIBRARY, PLUGINS) if room in path.parents)
    package = path.parent.relative_to(home).parts
    return ".".join(package[: len(package) - node.level + 1] + ((node.module,) if node.module else ()))


def imported(path: Path) -> Iterator[tuple[int, str]]:
    """(line, module) of every import, in functions too, and of import_module with a constant name."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.lineno, absolute_name(node, path)
        elif isinstance(node, ast.Call) and called(node).endswith("import_module") and node.args:
            name = node.args[0]
            if isinstance(name, ast.Constant) and isinstance(name.value, str) and not name.value.startswith("."):
                yield node.lineno, name.value


def called(node: ast.Call) -> str:
    """`torch.load` for a call of torch.load(...), '' for a call of something without a name."""
    try:
        return ast.unparse(node.func)
    except ValueError:
        return ""


def module_of(path: Path) -> str:
    """The dotted name of a file's module, a package's own for its __init__."""
    home = next(room.parent for room in (RUNTIME, LIBRARY, PLUGINS) if room in path.parents)
    parts = path.relative_to(home).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def imports_within(*rooms: Path) -> dict[str, set[str]]:
    """For each module of these rooms the others that it imports: in functions and under TYPE_CHECKING too, and a
    submodule that is imported from its package as that submodule."""
    modules = {module_of(path): path for path in sources(*rooms)}
    graph: dict[str, set[str]] = {}
    for module, path in modules.items():
        found = {name for _, name in imported(path)}
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                package = absolute_name(node, path)
                names = {f"{package}.{alias.name}" for alias in node.names} & modules.keys()
                found |= names
                if len(names) == len(node.names) and package != module:
                    found.discard(package)
        graph[module] = found & modules.keys() - {module}
    return graph


# the runtime's rooms, the lowest first: each may import what stands before it
FLOORS = (
    ("cpus", "version", "notes", "progress"), ("errors", "splatting_rule"), ("components", "plugins", "native_library"),
    ("geometry",), ("values",), ("formats",), ("bundle", "rigs"), ("motions",), ("decoding",), ("tiers",), ("avatar",),
    ("render", "web", "browser"), ("live", "play"), ("conversions", "view"), ("player_face",), ("cli",),
    ("gavatar_runtime",),
)  # fmt: skip
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else module


@parametrize_files(RUNTIME)
def test_a_room_of_the_runtime_imports_only_rooms_below_it(path):
    module = module_of(path)
    upwards = [
        name
        for name in imports_within(RUNTIME)[module]
        if room_of(name) != room_of(module) and FLOOR[room_of(name)] >= FLOOR[room_of(module)]
    ]
    assert upwards == []


@pytest.mark.parametrize("room", [RUNTIME, LIBRARY, PLUGINS], ids=lambda p: p.name)
def test_no_modules_import_each_other_in_a_circle(room):
    """Imports for type checkers count: what two modules need of each other belongs into a third."""
    graphlib.TopologicalSorter(imports_within(room)).prepare()  # raises CycleError, which names the circle


def test_the_check_of_circles_sees_imports_in_functions_and_for_type_checkers(tmp_path, monkeypatch):
    room = tmp_path / "gavatar_runtime"
    (room / "play").mkdir(parents=True)
    (room / "__init__.py").write_text("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .play import loop")
    (room / "play" / "__init__.py").write_text("")
    (room / "play" / "loop.py").write_text("def f():\n    from .. import face\n")
    (room / "face.py").write_text("from .play.loop import f\n")
    monkeypatch.setattr(sys.modules[__name__], "RUNTIME", room)
    graph = imports_within(room)
    assert graph["gavatar_runtime"] == {"gavatar_runtime.play.loop"}
    assert graph["gavatar_runtime.play.loop"] == {"gavatar_runtime.face"}
    with pytest.raises(graphlib.CycleError):
        graphlib.TopologicalSorter(graph).prepare()


def violations(path: Path, allowed) -> list[str]:
    return [f"line {line}: {name}" for line, name in imported(path) if not allowed(name.partition(".")[0])]


@parametrize_files(RUNTIME)
def test_the_runtime_imports_numpy_onnxruntime_and_the_standard_library_only(path):
    allowed = RUNTIME_MAY_IMPORT | ({"cv2"} if path in MAY_TRY_OPENCV else set())
    assert violations(path, lambda top: top in allowed or top in sys.stdlib_module_names) == []


@parametrize_files(RUNTIME)
def test_no_function_of_the_runtime_knows_of_commands_but_those_of_the_commands(path):
    if path.parent != RUNTIME / "cli":
        assert [n for _, n in imported(path) if n == "argparse" or n.startswith("gavatar_runtime.cli")] == []


@parametrize_files(LIBRARY)
def test_the_library_never_imports_a_plugin(path):
    if path != NAMES_THE_NAMESPACE:
        assert violations(path, lambda top: top != "gavatar_plugins") == []


@parametrize_files(PLUGINS)
def test_no_plugin_imports_another_plugin_by_its_absolute_name(path):
    """Plugins that share code put it into the library; a sibling in the same room may be imported."""
    room = ".".join(path.parent.relative_to(ROOT).parts)
    names = [name for _, name in imported(path) if name.startswith("gavatar_plugins")]
    assert [name for name in names if not name.startswith(room)] == []


def keyword(node: ast.Call, name: str) -> object:
    """The constant given for keyword `name`, Ellipsis if it is absent or not a constant."""
    values = [k.value for k in node.keywords if k.arg == name]
    return values[0].value if values and isinstance(values[0], ast.Constant) else ...


def unsafe_loads(source: str) -> list[str]:
    """Calls and imports that could run code from a data file."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [a.name for a in node.names if a.name in UNSAFE_MODULES and (a.name != "pickle" or a.asname)]
        elif isinstance(node, ast.ImportFrom) and node.module in UNSAFE_MODULES:
            found += [a.name for a in node.names if a.name not in EXCEPTIONS_OF_PICKLE]
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "pickle":
            found += [node.attr] * (node.attr not in EXCEPTIONS_OF_PICKLE)
        elif isinstance(node, ast.Call):
            name = called(node)
            if name in ("eval", "exec", "os.system", "yaml.load", "yaml.unsafe_load"):
                found.append(name)
            if name == "torch.load" and keyword(node, "weights_only") is not True:
                found.append("torch.load without weights_only=True")
            if name.split(".")[-1] == "load" and keyword(node, "allow_pickle") not in (..., False):
                found.append("load with allow_pickle")
            if name in ("np.load", "numpy.load") and keyword(node, "allow_pickle") is not False:
                found.append("np.load without allow_pickle=False")
    return found


@parametrize_files(RUNTIME, LIBRARY, PLUGINS)
def test_no_shipped_code_can_run_what_a_data_file_holds(path):
    found = unsafe_loads(path.read_text())
    assert [f for f in found if path != READS_PICKLES or f not in ("_Unpickler", "BUILD", "BYTEARRAY8")] == []


@pytest.mark.parametrize(
    "source",
    [
        "import dill",
        "import pickle as p",
        "import pickle; pickle.loads(b)",
        "from pickle import loads",
        "torch.load(f)",
        "torch.load(f, weights_only=False)",
        "torch.load(f, weights_only=flag)",
        "np.load(f)",
        "np.load(f, allow_pickle=True)",
        "eval(text)",
    ],
)
def test_the_check_itself_notices_an_unsafe_load(source):
    assert unsafe_loads(source)


@pytest.mark.parametrize(
    "source", ["torch.load(f, weights_only=True)", "np.load(f, allow_pickle=False)", "model.eval()"]
)
def test_the_check_itself_lets_a_safe_load_pass(source):
    assert unsafe_loads(source) == []


def test_relative_imports_are_resolved_from_the_place_of_the_file():
    node = ast.parse("from ..errors import UserError").body[0]
    assert absolute_name(node, RUNTIME / "motions" / "source.py") == "gavatar_runtime.errors"
    node = ast.parse("from . import registry").body[0]
    assert absolute_name(node, LIBRARY / "extras.py") == "gavatar"
