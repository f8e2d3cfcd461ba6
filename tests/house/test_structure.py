"""The house stays easy to see: one idea a file, names that say which half they are of, imports without circles."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from places import ROOT

HALVES = {"gavatar_runtime": ROOT / "deploy" / "gavatar_runtime", "gavatar": ROOT / "gavatar"}
HOMES = {**HALVES, "gavatar_plugins": ROOT / "gavatar_plugins"}
LONGEST_FUNCTION = 60  # lines: what fits on a screen
LONGEST_FILE = 400  # lines: past that a file is usually two ideas
LONGEST_TEST_FILE = 350
MOST_MODULES = 20  # in a folder


@cache
def modules() -> dict[str, Path]:
    """Every shipped module by its dotted name."""
    found = {}
    for package, home in HOMES.items():
        for path in home.rglob("*.py"):
            parts = [package, *path.relative_to(home).with_suffix("").parts]
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports_of(module: str, path: Path) -> set[str]:
    """The shipped modules that a module names in its imports, in functions and for type checking too."""
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            target = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{target}.{a.name}" if f"{target}.{a.name}" in modules() else target for a in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name in modules() and name != module}


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """The strongly connected components of more than one node (Tarjan 1972), each sorted."""
    index, low, stack, found = {}, {}, [], []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph.get(node, ()):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            component = [stack.pop()]
            while component[-1] != node:
                component.append(stack.pop())
            if len(component) > 1:
                found.append(sorted(component))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def room(module: str) -> str:
    """The room that a module is of: a folder of its half with all below it; one that lies beside these is its own."""
    return ".".join(module.split(".")[:2])


def test_no_module_imports_itself_through_others_type_checking_included():
    graph = {name: imports_of(name, path) for name, path in modules().items()}
    assert circles(graph) == []


def test_no_room_imports_itself_through_others_type_checking_included():
    graph: dict[str, set[str]] = {}
    for name, path in modules().items():
        graph.setdefault(room(name), set()).update(map(room, imports_of(name, path)))
    assert {"gavatar.avatar", "gavatar_runtime.cli", "gavatar_runtime.errors"} <= set(graph)
    assert circles(graph) == []


def test_the_search_for_circles_finds_one():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]


def test_no_file_name_is_used_in_both_halves():
    names = [{path.name for path in home.rglob("*.py")} - {"__init__.py"} for home in HALVES.values()]
    assert names[0] & names[1] == set()


def test_no_folder_is_crowded():
    folders = Counter(path.parent.relative_to(ROOT).as_posix() for path in modules().values())
    assert {folder: count for folder, count in folders.items() if count > MOST_MODULES} == {}


@pytest.mark.parametrize("package", HOMES)
def test_files_and_functions_fit_on_a_screen(package):
    long = []
    for path in HOMES[package].rglob("*.py"):
        text = path.read_text()
        if len(text.splitlines()) > LONGEST_FILE:
            long.append(f"{path.relative_to(ROOT)}: {len(text.splitlines())} lines")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.end_lineno - node.lineno >= LONGEST_FUNCTION:
                long.append(f"{path.relative_to(ROOT)}: {node.name}, {node.end_lineno - node.lineno + 1} lines")
    assert long == []


def test_files_of_tests_are_no_longer_than_one_topic_needs_and_have_names_of_their_own():
    """pytest would import two test files of one name as one module, and a name tells only where it is the only one."""
    files = sorted((ROOT / "tests").rglob("*.py"))
    assert len(files) > 100
    lines = {path.relative_to(ROOT).as_posix(): len(path.read_text().splitlines()) for path in files}
    assert {name: count for name, count in lines.items() if count > LONGEST_TEST_FILE} == {}
    names = Counter(path.name for path in files if path.name.startswith("test_"))
    assert [name for name, count in names.items() if count > 1] == []
