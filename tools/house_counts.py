"""Count what keeps the house easy to see, by the measures of tests/house/test_structure.py: files and folders at each
level, names in both halves, circles, long functions, and what a quantity that travels with a pose touches.

    python tools/house_counts.py

Prints the tables of docs/architecture.md.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / "house"), str(ROOT / "tests" / "support")]

from test_structure import HALVES, HOMES, LONGEST_FUNCTION, circles, imports_of, modules, room  # noqa: E402

TRAVELS = "expression"  # the last quantity that came to travel with a pose


def nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def levels(home: Path) -> str:
    """`10 files; 12 folders: 102 files; ...`, level by level."""
    files = Counter(len(path.relative_to(home).parts) - 1 for path in home.rglob("*.py"))
    folders = Counter(len(folder.relative_to(home).parts) for folder in {path.parent for path in home.rglob("*.py")})
    return "; ".join(
        f"{files[depth]} files" if depth == 0 else f"{folders[depth]} folders with {files[depth]} files"
        for depth in range(max(folders) + 1)
    )


def twins() -> tuple[list[str], list[str]]:
    """Names of files, and of public classes, that both halves have."""
    files = [{path.name for path in home.rglob("*.py")} - {"__init__.py"} for home in HALVES.values()]
    classes = [
        {
            node.name
            for path in home.rglob("*.py")
            for node in nodes(path)
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        }
        for home in HALVES.values()
    ]
    return sorted(files[0] & files[1]), sorted(classes[0] & classes[1])


def long_functions() -> int:
    return sum(
        isinstance(node, ast.FunctionDef) and node.end_lineno - node.lineno >= LONGEST_FUNCTION
        for path in modules().values()
        for node in nodes(path)
    )


def circles_of_rooms() -> list[list[str]]:
    graph: dict[str, set[str]] = {}
    for name, path in modules().items():
        graph.setdefault(room(name), set()).update(map(room, imports_of(name, path)))
    return circles(graph)


def named(path: Path, word: str) -> bool:
    """Whether a file's code has a variable, attribute, argument or field of that name."""
    names = set()
    for node in nodes(path):
        if isinstance(node, ast.Name):
            names.add(node.id)
        elif isinstance(node, ast.Attribute):
            names.add(node.attr)
        elif isinstance(node, ast.arg | ast.keyword):
            names.add(node.arg)
    return bool({word, f"_{word}"} & names)


def said(names: list) -> str:
    return f"{len(names)}: {', '.join(f'`{name}`' for name in names)}" if names else "0"


def main() -> None:
    files, classes = twins()
    graph = {name: imports_of(name, path) for name, path in modules().items()}
    rows = [(f"`{name}`", levels(home)) for name, home in HOMES.items()]
    rows += [
        ("files of one name in both halves", said(files)),
        ("public classes of one name in both halves", said(classes)),
        ("circles of modules, imports for types counted", said(circles(graph))),
        ("circles of rooms, imports for types counted", said(circles_of_rooms())),
        (f"functions over {LONGEST_FUNCTION} lines", str(long_functions())),
    ]
    print("| what | how many |\n|---|---|")
    for row in rows:
        print(f"| {row[0]} | {row[1]} |")
    print(f"\nFiles whose code names `{TRAVELS}`:\n")
    found: dict[str, list[str]] = {}
    for name, path in sorted(modules().items()):
        if named(path, TRAVELS):
            found.setdefault(room(name), []).append(path.relative_to(ROOT).as_posix())
    for names in found.values():
        print(f"- {', '.join(f'`{name}`' for name in names)}")


if __name__ == "__main__":
    main()
