"""No two modules need each other, not even for their types: each can be read after those it imports."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from places import ROOT

PACKAGES = (ROOT / "gavatar", ROOT / "gavatar_plugins", ROOT / "deploy" / "gavatar_runtime")


def module_files() -> dict[str, Path]:
    """The file of every module by its dotted name."""
    found = {}
    for package in PACKAGES:
        for path in package.rglob("*.py"):
            parts = path.relative_to(package.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(source: str, package: str, known: set[str]) -> set[str]:
    """Those of the modules `known` that a module in `package` imports anywhere: in functions and for types too."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *filter(None, [node.module])])
            names |= {full if (full := f"{base}.{alias.name}") in known else base for alias in node.names}
    return names & known


def cycle(graph: dict[str, set[str]]) -> list[str]:
    """Modules that import each other in a circle, the first again at the end; empty where none do."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_modules_import_each_other_in_a_circle():
    files = module_files()
    assert len(files) > 100
    graph = {}
    for name, path in files.items():
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        graph[name] = imported(path.read_text(encoding="utf-8"), package, set(files)) - {name}
    assert cycle(graph) == []


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("from .b import x", {"p.r.b"}),
        ("from . import b", {"p.r.b"}),
        ("from ..a import x", {"p.a"}),
        ("from .. import a, version", {"p.a", "p"}),
        ("import p.a as z", {"p.a"}),
        ("if TYPE_CHECKING:\n    from p.a import X", {"p.a"}),
        ("def f():\n    from .b import x", {"p.r.b"}),
        ("from numpy import x", set()),
    ],
)
def test_imports_are_found_wherever_they_stand(source, expected):
    assert imported(source, "p.r", {"p", "p.a", "p.r", "p.r.b"}) == expected


def test_a_circle_of_types_is_noticed():
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})
    assert cycle({"a": {"b"}, "b": {"c"}, "c": set()}) == []
