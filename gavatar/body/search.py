"""Where a user's body model files lie."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

ENVIRONMENT = "GAVATAR_BODY_MODELS"
_DEEPEST = 5


def search_folders(path: str = "") -> list[Path]:
    """Where body files are looked for: `path` (a folder, or the folder of a file) and then the folders of the
    environment variable GAVATAR_BODY_MODELS."""
    folders = []
    if path:
        given = Path(path).expanduser()
        folders.append(given if given.is_dir() else given.parent)
    folders += [Path(p).expanduser() for p in os.environ.get(ENVIRONMENT, "").split(os.pathsep) if p]
    return [folder for folder in folders if folder.is_dir()]


def files_below(folders: list[Path]) -> Iterator[tuple[str, Path]]:
    """(path relative to its folder, lower case, with /) and path of every file, near ones first, five levels deep."""
    for folder in folders:
        found = []
        for root, subfolders, names in os.walk(folder, followlinks=True):
            depth = len(Path(root).relative_to(folder).parts)
            if depth >= _DEEPEST:
                subfolders.clear()
            subfolders[:] = sorted(s for s in subfolders if not s.startswith("."))
            found += [(depth, n, Path(root) / n) for n in names]
        for _, _, path in sorted(found):
            yield path.relative_to(folder.parent).as_posix().lower(), path
