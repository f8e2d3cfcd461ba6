"""Write docs/reference/python_api.md from the two faces: every public name, its signature, its docstring.

    python tools/api_page.py [--check]

--check: exit 1 where the page is not what would be written, and write nothing.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import gavatar
import gavatar_runtime

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "python_api.md"
HEAD = """# Python API

Two libraries. `gavatar_runtime` plays and needs no PyTorch; `gavatar` trains. What stands here is public; everything
else may change. `python tools/api_page.py` writes this page from the code.
"""


def signature(name: str, thing: Any) -> str:
    """`name(arguments) -> result`, defaults as they are written."""
    try:
        text = str(inspect.signature(thing))
    except (TypeError, ValueError):
        return name
    text = re.sub(r"<function (\w+).*?>", r"\1", re.sub(r"\bself(, )?", "", text))
    return name + text.replace("'", "")


def paragraphs(thing: Any) -> str:
    """The docstring, its code blocks fenced."""
    text = inspect.getdoc(thing) or ""
    return re.sub(
        r"::\n\n((?:    .*\n?|\n)+)", lambda m: f":\n\n```python\n{textwrap.dedent(m[1]).strip()}\n```\n", text
    )


def members(kind: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties that a class of ours defines, in the order of the source."""
    for name, member in vars(kind).items():
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, property | classmethod)):
            yield name, member


def entry(name: str, thing: Any) -> list[str]:
    """The part of the page about one name."""
    lines = [f"### `{name}`", ""]
    if inspect.isclass(thing) or inspect.isfunction(thing):
        lines += ["```python", signature(name, thing), "```", ""]
    lines += [paragraphs(thing), ""]
    if not inspect.isclass(thing) or issubclass(thing, Exception):
        return lines
    for own, member in members(thing):
        function = member.__func__ if isinstance(member, classmethod) else getattr(member, "fget", member)
        title = own if isinstance(member, property) else signature(own, function)
        lines += [f"- `{title}`", textwrap.indent(" ".join((inspect.getdoc(function) or "").split()), "  "), ""]
    return lines


def section(module: ModuleType) -> list[str]:
    """The part of the page about one library."""
    lines = [f"## `{module.__name__}`", ""]
    for name in sorted(module.__all__, key=str.lower):
        thing = getattr(module, name)
        if not name.startswith("__") and (callable(thing) or dataclasses.is_dataclass(thing)):
            lines += entry(name, thing)
    return lines


def page() -> str:
    """All of it."""
    text = "\n".join([HEAD, *section(gavatar_runtime), *section(gavatar)])
    return re.sub(r"\n{3,}", "\n\n", "\n".join(line.rstrip() for line in text.splitlines())) + "\n"


def main() -> int:
    if "--check" in sys.argv[1:]:
        return int(PAGE.read_text(encoding="utf-8") != page())
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
