"""The files of a folder that are footage, in the order in which they were filmed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gavatar_runtime.errors import UserError
from gavatar_runtime.motions.estimators.found import natural

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tif", ".tiff")


def footage_files(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Files of those suffixes, their numbers counted: 2.png before 10.png. What systems leave behind (._2.png,
    .DS_Store, Thumbs.db) is passed over."""
    files = (p for p in sorted(folder.iterdir()) if p.suffix.lower() in suffixes and not is_foreign(p) and p.is_file())
    return sorted(files, key=lambda p: natural(p.name))


def is_foreign(path: Path) -> bool:
    """Whether an operating system left this there: hidden files, AppleDouble's ._NAME, the folder of macOS archives."""
    return path.name.startswith(".") or path.name == "__MACOSX"


def number_order_note(name: str, files: list[Path]) -> list[str]:
    """A sentence where the order of numbers is not that of the letters, which other programs may have taken."""
    by_letters = sorted(files)
    if by_letters == files:
        return []
    k = next(k for k, (a, b) in enumerate(zip(files, by_letters, strict=True)) if a != b)
    return [
        f"{name}: frames are taken in the order of their numbers ({files[k].name} before {by_letters[k].name}): "
        "landmarks from elsewhere must have the same order"
    ]


def twice(files: list[Path]) -> None:
    """UserError where one frame is there under two suffixes, such as 1.png and 1.jpg."""
    seen: dict[str, Path] = {}
    for path in files:
        other = seen.setdefault(path.stem, path)
        if other is not path:
            raise UserError(f"{path.parent} holds {other.name} and {path.name}: leave one image of each frame there")
