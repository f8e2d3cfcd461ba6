"""The types: every argument has one, mypy agrees with them, and a program that uses the library sees them."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

HOMES = ("gavatar", "gavatar_plugins", "deploy/gavatar_runtime")
WRONG = """
import gavatar
import gavatar_runtime as gr

avatar = gr.load("anna.gavatar", uv="128")  # wrong: a number
avatar.render(size="large")  # wrong: a number
avatar.raise_arm()  # wrong: no such method
gr.read_motion(3)  # wrong: a name or a path
gr.Avatr  # wrong: no such class
gavatar.train(7)  # wrong: a folder or a capture
gavatar.open_run("runs/anna").export(uvs=64)  # wrong: no such option
gavatar.open_capture("captures/anna").frames  # wrong: no such field
"""


def mypy(*arguments: str | Path) -> subprocess.CompletedProcess:
    """mypy by the settings of pyproject.toml, its cache shared with `make lint`."""
    pytest.importorskip("mypy")
    pytest.importorskip("torch")  # whose types the trainer's are made of
    command = [sys.executable, "-m", "mypy", "--no-error-summary", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


def arguments(tree: ast.Module) -> list[ast.arg]:
    """Of every function; `self` and `cls` need no type, and those of a lambda can have none."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
            found += [a for a in every if a is not None and a.arg not in ("self", "cls")]
    return found


def test_every_argument_is_typed():
    found = {
        path: arguments(ast.parse(path.read_text(encoding="utf-8")))
        for home in HOMES
        for path in (ROOT / home).rglob("*.py")
    }
    assert sum(map(len, found.values())) > 3000
    assert [f"{path}:{a.lineno} {a.arg}" for path, given in found.items() for a in given if a.annotation is None] == []


@pytest.mark.slow
def test_mypy_passes_on_both_halves_and_on_a_program_that_uses_them():
    done = mypy()
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_mypy_refuses_wrong_calls_of_both_faces(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(WRONG, encoding="utf-8")
    done = mypy(program)
    wrong = {number for number, line in enumerate(WRONG.splitlines(), 1) if "# wrong" in line}
    told = {
        int(line.split(":")[1]) for line in done.stdout.splitlines() if "program.py:" in line and ": error:" in line
    }
    assert told == wrong, done.stdout + done.stderr


def test_no_error_of_mypy_is_silenced_without_its_name():
    for home in HOMES:
        for path in (ROOT / home).rglob("*.py"):
            for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
                silenced = "# type: " + "ignore"
                assert silenced not in line or f"{silenced}[" in line, f"{path}:{number}"
