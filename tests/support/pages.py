"""The pages of the project, and the commands that they show."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from places import ROOT

PAGES = [ROOT / "README.md", ROOT / "deploy/README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES += sorted((ROOT / "gavatar/data").glob("*/README.md"))
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
COMMANDS = {
    "gavatar-train": "gavatar.cli.train",
    "gavatar-make": "gavatar.cli.make",
    "gavatar-demo": "gavatar.cli.demo",
    "gavatar-prepare": "gavatar.cli.prepare",
    "gavatar-eval": "gavatar.cli.evaluate",
    "gavatar-export": "gavatar.cli.export",
    "gavatar-tradeoff": "gavatar.cli.tradeoff",
    "gavatar-list": "gavatar.cli.list",
    "gavatar-play": "gavatar_runtime.cli.play",
    "gavatar-view": "gavatar_runtime.cli.view",
    "gavatar-convert": "gavatar_runtime.cli.convert",
    "gavatar-motion": "gavatar_runtime.cli.motion_files",
}
FENCE = re.compile(r"^```(?:\w*)\n(.*?)^```", re.M | re.S)
INDENTED = re.compile(r"(?:^    .*\n?)+", re.M)
SPAN = re.compile(r"`([^`\n]+)`")


def prose(page: Path) -> str:
    """Without fenced blocks, and with each code span on one line."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    return re.sub(r"`[^`]+`", lambda span: " ".join(span[0].split()), text)


def commands(page: Path, spans: bool = True) -> list[list[str]]:
    """Every command of the page, in blocks and, unless told otherwise, in code spans, as words."""
    text = page.read_text(encoding="utf-8")
    blocks = [*FENCE.findall(text), *INDENTED.findall(FENCE.sub("", text))]
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    found = []
    for line in [*lines, *(SPAN.findall(prose(page)) if spans else [])]:
        line = re.sub(r"^\$ |\s#.*$|\[precision=\w+\]|^PYTHONPATH=\S+ |^OMP_NUM_THREADS=\d ", "", line.strip())
        if line.startswith(("gavatar-", "python benchmarks/", "python tools/", "python tests/")):
            found.append(shlex.split(line))
    return found
