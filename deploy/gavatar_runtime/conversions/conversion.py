"""The registry of conversions, and how a path or a name finds its own."""

from __future__ import annotations

import abc
import dataclasses
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from ..avatar.playing import Avatar
from ..bundle import Bundle
from ..components import Component, Registry
from ..errors import WrongValue, did_you_mean
from ..motions import MOTIONS, read_motion
from ..play.outputs.output import suffix_of
from ..play.selection import wanted_count
from ..plugins import load_entry_points
from ..values.motion import Motion


@dataclasses.dataclass(frozen=True, eq=False)
class Request:
    """What is to be written. avatar: opened with tier=None: its body and its bundle. motions: fitted to the body, each
    with a name of its own, at least one. tier: the one asked for, None for the conversion's choice. gaussians: at most
    so many, None for all."""

    avatar: Avatar
    motions: tuple[Motion, ...]
    tier: str | None = None
    gaussians: int | None = None


class Conversion(abc.ABC):
    """Constructed as `factory(options)`. suffixes: of the paths that it writes, lower case with their dots; `/` is a
    folder; none where it is chosen by its name alone. notes: sentences for the user that came up."""

    suffixes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, options: Any):
        self.options = options
        self.notes: list[str] = []

    @abc.abstractmethod
    def write(self, request: Request, path: Path) -> None:
        """Write it whole or not at all. UserError for what cannot be converted or written."""


CONVERSIONS: Registry[Conversion] = Registry("conversion", base=Conversion)


def find_conversion(path: str | os.PathLike, name: str | None = None) -> Component[Conversion]:
    """The conversion called `name`, or else the one that writes what is called `path`. Plugins are imported only when
    no built-in one fits. Raises UserError for an unknown name and for a suffix that nothing writes."""
    suffix = suffix_of(path)
    if name is not None:
        if name not in CONVERSIONS:
            load_entry_points()
        suffixes = _suffixes(CONVERSIONS[name])
        if suffixes and suffix not in suffixes:
            raise WrongValue(f"conversion '{name}' cannot write '{path}': {did_you_mean(suffix, suffixes)}")
        return CONVERSIONS[name]
    if not any(suffix in _suffixes(c) for c in CONVERSIONS):
        load_entry_points()
    found = next((c for c in CONVERSIONS if suffix in _suffixes(c)), None)
    if found is None:
        suffixes = tuple(s for component in CONVERSIONS for s in _suffixes(component))
        raise WrongValue(
            f"an avatar cannot be turned into '{path}': {did_you_mean(suffix, suffixes)} (gavatar-play writes single "
            "frames and videos)"
        )
    return found


def default_motions() -> list[str]:
    """The built-in motions that show an avatar: the one that plays where none is asked for, and those that vary."""
    return list(dict.fromkeys([MOTIONS.default, *MOTIONS.having(varied=True)]))


def convert(
    bundle: Bundle | str | os.PathLike,
    path: str | os.PathLike,
    *,
    motions: Iterable[str | Path | Motion] | None = None,
    tier: str | None = None,
    gaussians: int | Literal["auto"] | None = None,
    name: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> tuple[str, ...]:
    """Turn an avatar into another program's file, by the suffix of `path`, and return what there is to note of it.

    bundle: an opened one or its path. motions: that go with it, built-in ones by name, files or `Motion`s, None for
    `default_motions`; the first plays at the start. tier: how its look is taken, None for the conversion's choice.
    gaussians: at most so many, `auto` for as many as the footage's pixels were worth, None for all.
    name, options: of the conversion, where the suffix does not tell, and options of its own.
    Raises UserError for whatever cannot be read, converted or written.
    """
    conversion = CONVERSIONS.build(find_conversion(path, name).name, options)
    avatar = Avatar(bundle, tier=None)
    wanted = list(default_motions() if motions is None else motions) or [MOTIONS.default]
    read = [m if isinstance(m, Motion) else read_motion(m) for m in wanted]
    fitted = _told_apart([avatar.fit(motion) for motion in read], conversion.notes)
    count = None if gaussians is None else wanted_count(gaussians, avatar.surface, avatar.pixel)
    conversion.write(Request(avatar, fitted, tier, count), Path(path))
    return tuple(dict.fromkeys(conversion.notes))


def _told_apart(fitted: list[tuple[Motion, tuple[str, ...]]], notes: list[str]) -> tuple[Motion, ...]:
    """The motions under names of their own; what the body lacks is noted."""
    named: dict[str, Motion] = {}
    for motion, lacking in fitted:
        base = name = motion.name or "motion"
        number = 2
        while name in named:
            name, number = f"{base}_{number}", number + 1
        named[name] = dataclasses.replace(motion, name=name)
        notes += motion.notes
        if lacking:
            notes.append(f"the body has no {', '.join(lacking)}: what '{name}' does there is left out")
    return tuple(named.values())


def _suffixes(component: Component[Conversion]) -> tuple[str, ...]:
    return tuple(component.kind.suffixes)  # of a class derived from Conversion: the registry takes nothing else
