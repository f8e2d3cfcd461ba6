"""The kernel's sources stay as easy to read as the rest of the house: one idea a file, lines that fit beside
another."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import ROOT

NATIVE = ROOT / "deploy" / "native"
SOURCES = sorted(path for path in NATIVE.iterdir() if path.suffix in (".h", ".cpp"))
LONGEST_LINE = 100
LONGEST_FILE = 350  # lines: past that a file is usually two ideas


def parametrize_sources(paths: list[Path]):
    return pytest.mark.parametrize("path", paths, ids=lambda path: path.name)


@parametrize_sources(SOURCES)
def test_no_line_is_too_long_and_no_file_holds_two_ideas(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert [f"line {n}: {len(line)}" for n, line in enumerate(lines, 1) if len(line) > LONGEST_LINE] == []
    assert len(lines) <= LONGEST_FILE


@parametrize_sources([path for path in SOURCES if path.name.endswith("-inl.h")])
def test_what_is_compiled_once_per_instruction_set_stays_in_its_namespace(path):
    """Elsewhere the linker could choose code of a better instruction set for the baseline too."""
    text = path.read_text(encoding="utf-8")
    assert "#pragma once" in text
    assert "namespace gv::GV_NAMESPACE {" in text
    assert "#include <vector>" not in text
    assert "std::" not in text


def test_every_file_is_a_source_or_a_header():
    assert sorted(path for path in NATIVE.iterdir() if not path.name.startswith(".")) == SOURCES
