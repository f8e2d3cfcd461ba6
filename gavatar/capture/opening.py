"""Opening a capture: which reader recognises a folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from gavatar_runtime.errors import UserError

from ..registry import CAPTURES, resolve, split_node
from .capture import Capture


def open_capture(path: str | os.PathLike[str], node: dict[str, Any] | None = None) -> Capture:
    """Open the capture at `path` with the reader of `node`, by default the first that recognises the folder.
    Raises UserError when the folder is missing, of no known layout, or malformed."""
    path = Path(path)
    name, options = split_node(resolve(CAPTURES, node or {"name": CAPTURES.default}, path))
    return CAPTURES.build(name, options).read(path)


def capture_format(path: Path) -> str:
    """The name of the layout that recognises a folder; UserError when it is missing or none does."""
    if not path.is_dir():
        raise UserError(f"capture {path} is not a directory")
    for component in CAPTURES:
        if component.kind.recognises(path):
            return component.name
    known = "; ".join(f"{c.name}: {c.kind.signs}" for c in CAPTURES if c.kind.signs)
    raise UserError(f"{path} is not a capture: none of the known layouts fits ({known})")
