"""The pages against the code: links, files, tests, options and overrides that they name."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from pages import COMMANDS, FENCE, NAMES, PAGES, SPAN, commands, prose
from places import ROOT

from gavatar.config import MotionConfig, TrainConfig, check, compose_config
from gavatar.registry import load_plugins

GENERATED = ROOT / "docs/reference/python_api.md"  # by tools/api_page.py, from docstrings
WRITTEN = [page for page in PAGES if page != GENERATED]
STAND_INS = ("decoder=tinydecoder", "decoder.width=8")  # the guide's example, which is not installed here


@cache
def options_of(program: str) -> str:
    """Help of a command, or the source of a script of ours."""
    if program.endswith(".py"):
        return (ROOT / program).read_text(encoding="utf-8")
    out = io.StringIO()
    main = importlib.import_module(COMMANDS[program]).main
    calls = [["--help"]] if program != "gavatar-motion" else [["info", "--help"], ["convert", "--help"]]
    for arguments in calls:
        with contextlib.redirect_stdout(out), pytest.raises(SystemExit):
            main(arguments)
    return out.getvalue()


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            path, _, anchor = target.partition("#")
            file = (page.parent / path).resolve() if path else page
            assert file.exists(), target
            assert not anchor or anchor in anchors(file), target


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_files_and_tests_that_are_named_exist(page):
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"(?<![\w/.])(?:tests|benchmarks|tools|deploy|gavatar|gavatar_plugins)/[\w/.]+\.\w+", text):
        assert (ROOT / name).exists() or name == "gavatar_plugins/decoders/tiny.py", name
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py"))
    for name in re.findall(r"`(test_\w+?)(?:_?\.\.\.)?`", text):
        assert f"def {name}" in sources, name


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_options_of_commands_that_are_shown_exist(page):
    for program, *words in commands(page):
        program = words[0] if program == "python" else program
        if program == "gavatar-train":
            continue
        known = re.findall(r"--[a-z][\w-]*", options_of(program))
        for option in re.findall(r"(?<!\S)--[a-z][\w-]*", " ".join(words)):
            assert option in known, f"{program} {option}"


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_overrides_that_are_shown_compose(page):
    load_plugins()
    root = compose_config(["capture=x"])
    shown = [words for program, *words in commands(page) if program == "gavatar-train"]
    shown += [span.split() for span in SPAN.findall(prose(page)) if "=" in span and "--set" not in span]
    for words in shown:
        overrides = [w for w in words if re.fullmatch(r"\+?[a-z_0-9.]+=.+", w) and w not in STAND_INS]
        overrides = [w for w in overrides if not re.search(r"=\w+,|[A-Z]{4}", w)]  # a sweep; a name to fill in
        keys = {re.split(r"[.=]", w.lstrip("+"))[0] for w in overrides} - {"experiment"}
        if keys <= set(root):
            check(compose_config(["capture=x", *overrides]))


def test_every_option_of_a_run_is_named():
    text = "\n".join(prose(page) for page in PAGES)
    options = [f.name for f in dataclasses.fields(TrainConfig)]
    options += [f"motion.{f.name}" for f in dataclasses.fields(MotionConfig)]
    beside = {"motion.sharing_final", "motion.sharing_end"}  # named beside motion.sharing
    assert [o for o in options if o not in beside and not re.search(rf"\b{re.escape(o)}\b", text)] == []


def test_every_figure_is_shown():
    shown = {name for page in PAGES for name in re.findall(r"figures/([\w.]+)\)", page.read_text(encoding="utf-8"))}
    assert shown == {path.name for path in (ROOT / "docs/figures").iterdir()}


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_lines_are_short(page):
    lines = FENCE.sub("", page.read_text(encoding="utf-8")).splitlines()
    assert [line for line in lines if len(line) > 120 and not line.startswith(("|", "!["))] == []


def test_the_page_of_the_python_api_is_what_the_code_says():
    done = subprocess.run([sys.executable, str(ROOT / "tools/api_page.py"), "--check"])
    assert done.returncode == 0, "write it again: python tools/api_page.py"
