"""Writing files whole or not at all."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import UserError


def temporary_beside(path: str | os.PathLike) -> Path:
    """An empty temporary file in the folder of `path`, made if need be, with the suffix of `path`.

    Raises UserError when the place cannot be written to.
    """
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path} is a directory: give the name of a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror or error}") from error
    os.close(handle)
    return Path(name)


def put_in_place(temporary: Path, path: str | os.PathLike) -> None:
    """Rename a file of `temporary_beside` over `path`, readable like any other new file."""
    umask = os.umask(0)
    os.umask(umask)
    os.chmod(temporary, 0o666 & ~umask)  # mkstemp makes files that only their owner reads
    os.replace(temporary, path)


@contextlib.contextmanager
def atomic(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, renamed over it when the block succeeds and removed when not.

    Raises UserError when the place cannot be written to.
    """
    temporary = temporary_beside(path)
    try:
        yield temporary
        put_in_place(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: str | os.PathLike, value: Any) -> None:
    """Write `value` as indented JSON."""
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
