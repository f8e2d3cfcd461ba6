"""docs/reference/extremes.md: every row says which test shows it, and the test is there."""

from __future__ import annotations

import re

from places import ROOT

PAGE = ROOT / "docs" / "reference" / "extremes.md"


def rows() -> list[list[str]]:
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if row[-1] != "test" and not set(row[-1]) <= {"-"}]


def test_every_edge_is_shown_by_a_test_that_exists():
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    assert len(rows()) > 40
    for row in rows():
        name = re.fullmatch(r"`(test_\w+)`", row[-1])
        assert name, row
        assert re.search(rf"^def {name[1]}\(", sources, re.M), name[1]


def test_both_halves_are_in_the_table():
    halves = {row[1] for row in rows() if len(row) == 5}
    assert {"both", "numpy", "torch"} <= halves
