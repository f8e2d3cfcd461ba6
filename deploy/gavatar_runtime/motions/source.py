"""The registry of motion sources, and how a name or a file finds its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Protocol

from ..components import Component, Registry
from ..errors import MissingFile, UserError, WrongValue, did_you_mean
from ..plugins import load_entry_points
from ..values.motion import Motion


class MotionSource(Protocol):
    """What a registered class does. A built-in motion is constructed as `factory(config)`; a file format has the class
    attribute `suffixes`, lower case and with their dots, and is constructed as `factory(config, path=path)`; so is one
    with the class attribute `folder = True`, which reads folders. It may have `facts`, what a user wants to know of how
    it was read, by name, once it is."""

    suffixes: tuple[str, ...]

    def load(self) -> Motion:
        """The motion; UserError for whatever is wrong with the file or the options."""


@dataclasses.dataclass(frozen=True)
class MotionTraits:
    """varied: a built-in motion whose poses vary, so that what playing costs and loses can be measured by it."""

    varied: bool = False


MOTIONS: Registry[MotionSource] = Registry("motion", MotionTraits)


def read_motion(source: str | Path, **options: Any) -> Motion:
    """The motion called `source` (a built-in name, `turn`) or stored in the file `source`, by its suffix.

    options: of that motion's config dataclass. Plugins are imported only when no built-in source fits, so that playing
    stays free of whatever they import. Raises UserError for an unknown name or suffix, a missing file, a wrong option.
    """
    return motion_source(source, **options).load()


def motion_source(source: str | Path, **options: Any) -> MotionSource:
    """What reads that motion, as `read_motion` finds it."""
    component = _find(source)
    if component is None:
        load_entry_points()
        component = _find(source)
    if component is None:
        raise WrongValue(_unknown(str(source)))
    if not _suffixes(component) and not _is_folder(component):
        return MOTIONS.build(component.name, options)
    path = Path(source)
    if not path.is_file() and not (_is_folder(component) and path.is_dir()):
        if path.is_dir():
            raise UserError(f"motion file {path} is a directory")
        raise MissingFile(f"motion file {path} does not exist")
    return MOTIONS.build(component.name, options, path=path)


def _suffixes(component: Component) -> tuple[str, ...]:
    return getattr(component.factory, "suffixes", ())


def _is_folder(component: Component) -> bool:
    return getattr(component.factory, "folder", False)


def _find(source: str | Path) -> Component | None:
    if isinstance(source, str) and source in MOTIONS and not _suffixes(MOTIONS[source]):
        return MOTIONS[source] if not _is_folder(MOTIONS[source]) else None
    suffix = Path(source).suffix.lower()
    named = next((c for c in MOTIONS if suffix in _suffixes(c)), None)
    if named is None and str(source) not in ("", ".") and Path(source).is_dir():
        return next((c for c in MOTIONS if _is_folder(c)), None)
    return named


def _unknown(source: str) -> str:
    names = [c.name for c in MOTIONS if not _suffixes(c) and not _is_folder(c)]
    suffixes = sorted({s for c in MOTIONS for s in _suffixes(c)})
    hint = did_you_mean(source, names)
    return f"unknown motion '{source}': give a file ({', '.join(suffixes)}) or a built-in name, {hint}"
