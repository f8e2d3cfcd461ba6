"""What a component can is declared, by traits or a base class with defaults; nobody gropes for attributes. And what a
function of the library needs are values, not a command's arguments."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest
from places import ROOT

HOMES = (ROOT / "deploy" / "gavatar_runtime", ROOT / "gavatar", ROOT / "gavatar_plugins")
# where an attribute is asked for that may be missing, and why
ALLOWED = {
    ("deploy/gavatar_runtime/cpus.py", "sched_getaffinity"): "not of every operating system",
    ("gavatar/training/precision.py", "get_capabilities"): "not of every torch that is supported",
    ("gavatar/assemble.py", "member"): "a network that has more than its traits declare is refused",
}


def groping(source: str) -> Iterator[tuple[int, str]]:
    """(line, attribute) of every hasattr, and of every getattr that goes on where the attribute is missing."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
            continue
        if node.func.id == "hasattr" or (node.func.id == "getattr" and len(node.args) > 2):
            name = node.args[1]
            yield node.lineno, name.value if isinstance(name, ast.Constant) else ast.unparse(name)


def takes_arguments(source: str) -> Iterator[tuple[int, str]]:
    """(line, function) of every function that is given an argparse.Namespace, by its annotation or by a call with the
    name that `parse_args` was stored under."""
    tree = ast.parse(source)
    parsed = {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)
        if isinstance(node.value.func, ast.Attribute) and node.value.func.attr == "parse_args"
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            if any(a.annotation is not None and "Namespace" in ast.unparse(a.annotation) for a in given):
                yield node.lineno, node.name
        elif isinstance(node, ast.Call) and ast.unparse(node.func) not in ("vars", "as_flags"):
            handed = [*node.args, *(keyword.value for keyword in node.keywords)]
            if any(isinstance(value, ast.Name) and value.id in parsed for value in handed):
                yield node.lineno, ast.unparse(node.func)


def test_nobody_asks_whether_a_component_has_an_attribute():
    found = {}
    for home in HOMES:
        for path in home.rglob("*.py"):
            for line, name in groping(path.read_text()):
                found[path.relative_to(ROOT).as_posix(), name] = line
    assert {place: line for place, line in found.items() if place not in ALLOWED} == {}
    assert ALLOWED.keys() <= found.keys(), "places that no longer ask"


def test_no_function_is_given_the_arguments_of_a_command():
    found = [
        f"{path.relative_to(ROOT).as_posix()}:{line} {name}"
        for home in HOMES
        for path in home.rglob("*.py")
        for line, name in takes_arguments(path.read_text())
    ]
    assert found == []


@pytest.mark.parametrize("source", ['hasattr(x, "step")', 'getattr(x, "step", None)', "f(getattr(x, name, ()))"])
def test_the_check_itself_notices_groping(source):
    assert len(list(groping(source))) == 1


@pytest.mark.parametrize("source", ["getattr(config, field.name)", 'importlib.import_module("a")', "x.hasattr(1)"])
def test_the_check_itself_lets_reading_of_fields_pass(source):
    assert list(groping(source)) == []


@pytest.mark.parametrize(
    "source",
    [
        "def run(a: argparse.Namespace): pass",
        "def run(*, a: Namespace): pass",
        "def main():\n    a = parser().parse_args()\n    run(1, a)",
        "def main():\n    a = p.parse_args(argv)\n    run(given=a)",
    ],
)
def test_the_check_itself_notices_arguments_that_are_handed_on(source):
    assert list(takes_arguments(source)) == [(source.count("\n") + 1, "run")]


def test_the_check_itself_lets_values_pass():
    assert list(takes_arguments("def main():\n    a = p.parse_args(argv)\n    run(a.out, **vars(a))")) == []
