"""What played frames go into: the registry of outputs, and how a path or a name finds its own.

An output is constructed as `factory(options, path=path, frames=FrameFormat)`, which checks that the place can be
written, and says by `choose` which of the frames it wants; each then comes through `add`, and `close` finishes the
output. What it writes appears under its name when it is whole, or not at all.
"""

from __future__ import annotations

import abc
import dataclasses
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from ...components import Component, Registry
from ...errors import WrongValue, did_you_mean
from ...plugins import load_entry_points
from ...values.gaussians import Gaussians

FOLDER = "/"  # what stands for the suffix of a folder
NUMBERED = "%d"  # and before that of a name with a frame's number in it, such as frames/%06d.ply
NUMBER = re.compile(r"%0?(\d*)d")

Frame = TypeVar("Frame", np.ndarray, Gaussians)


@dataclasses.dataclass(frozen=True)
class FrameFormat:
    """What all frames have in common. fps: frames per second. width, height: pixels, 0 for an output of Gaussians.
    background: sRGB in [0, 1] behind the person. pixel: metres of the person that a pixel of the training images
    spanned, for an output of Gaussians, None where that is not known."""

    fps: float
    width: int = 0
    height: int = 0
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    pixel: float | None = None


class Output(abc.ABC, Generic[Frame]):
    """Where frames go: derive from `ImageOutput` or `GaussianOutput`.

    wants: what its frames are. suffixes: of the paths it writes, lower case with their dots; `/` is a folder, `%d.ply`
    a name with a frame's number in it; none where it is chosen by its name alone.
    path: as it was given. notes: sentences for the user that came up so far.
    """

    wants: ClassVar[Literal["image", "gaussians"]]
    suffixes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, path: Path):
        self.path = path
        self.notes: list[str] = []

    def choose(self, count: int) -> list[int]:
        """Which of `count` frames it wants, ascending."""
        return list(range(count))

    @abc.abstractmethod
    def add(self, frame: Frame) -> None:
        """Take the next wanted frame, whose arrays the caller may use again. UserError if it cannot be written."""

    @abc.abstractmethod
    def close(self) -> None:
        """Finish the output and put it in place. UserError if what was written is not whole."""

    @abc.abstractmethod
    def discard(self) -> None:
        """Leave nothing behind; harmless after `close`."""


class ImageOutput(Output[np.ndarray]):
    """Its frames are drawn: (H, W, 3) uint8 RGB of the size in its `FrameFormat`."""

    wants = "image"


class GaussianOutput(Output[Gaussians]):
    """Its frames are the avatar's Gaussians themselves, in the world; nothing is drawn."""

    wants = "gaussians"


@dataclasses.dataclass(frozen=True)
class OutputTraits:
    """preference: of several that write a suffix the highest is taken; so it is of all that can be had here, where none
    is asked for."""

    preference: int = 0


OUTPUTS: Registry[Output[Any]] = Registry("output", OutputTraits, base=Output)


def default_output() -> tuple[Component[Output[Any]], Component[Output[Any]]]:
    """The output that is taken where none is asked for, and the one that would be if everything could be had here."""
    ranked = _ranked(OUTPUTS)
    return next(component for component in ranked if not component.missing()), ranked[0]


def _ranked(components: Iterable[Component[Output[Any]]]) -> list[Component[Output[Any]]]:
    def preference(component: Component[Output[Any]]) -> int:
        return 0 if component.default_traits is None else component.default_traits.preference

    return sorted(components, key=preference, reverse=True)


def output_called(name: str) -> type[Output[Any]]:
    """The output of that name. Raises UserError with the choices where there is none."""
    if name not in OUTPUTS:
        load_entry_points()
    return OUTPUTS[name].kind


def find_output(path: str | os.PathLike, name: str | None = None) -> type[Output[Any]]:
    """The output called `name`, or else the one that writes what is called `path`, by its suffix: a name without one,
    or an existing folder, is a folder of frames.

    Plugins are imported only when no built-in output fits. Raises UserError for an unknown name, a suffix that nothing
    writes, or one that the output of that name does not.
    """
    return _find(path, name).kind


def open_output(
    path: str | os.PathLike, frames: FrameFormat, *, name: str | None = None, options: Mapping[str, Any] | None = None
) -> Output[Any]:
    """The output of `find_output`, with `options` of its own, ready for frames.

    Raises UserError as that does, for an unknown option and for a place that cannot be written to.
    """
    return OUTPUTS.build(_find(path, name).name, options, path=Path(path), frames=frames)


def save_gaussians(
    path: str | os.PathLike,
    gaussians: Gaussians,
    *,
    name: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> tuple[str, ...]:
    """Write the Gaussians of one frame, in the world, to `path`, and return what there is to note of it.

    Raises UserError as `open_output` does, and for an output of images.
    """
    if find_output(path, name).wants != GaussianOutput.wants:
        formats = [s for c in OUTPUTS if c.kind.wants == GaussianOutput.wants for s in c.kind.suffixes]
        raise WrongValue(
            f"{path} is an output of images, not of Gaussians: {_choices(suffix_of(path), tuple(formats))}"
        )
    output = open_output(path, FrameFormat(fps=1.0), name=name, options=options)
    try:
        output.choose(1)
        output.add(gaussians)
        output.close()
    finally:
        output.discard()
    return tuple(output.notes)


def _find(path: str | os.PathLike, name: str | None) -> Component[Output[Any]]:
    suffix = suffix_of(path)
    if name is not None:
        suffixes = output_called(name).suffixes
        if suffixes and suffix not in suffixes:
            raise WrongValue(f"output '{name}' cannot write '{path}': {_choices(suffix, suffixes)}")
        return OUTPUTS[name]
    if not _writers_of(suffix):
        load_entry_points()
    found = _writers_of(suffix)
    if not found:
        suffixes = tuple(s for component in OUTPUTS for s in component.kind.suffixes)
        raise WrongValue(f"cannot write '{path}': {_choices(suffix, suffixes)} (a name without suffix is a folder)")
    return found[0]


def suffix_of(path: str | os.PathLike) -> str:
    """`/` for a folder, there or meant by its name, `%d.ply` for a name with a frame's number, else the suffix."""
    if str(path).endswith(("/", "\\")) or Path(path).is_dir():
        return FOLDER
    suffix = Path(path).suffix.lower()
    return NUMBERED + suffix if NUMBER.search(Path(path).name) else suffix or FOLDER


def _writers_of(suffix: str) -> list[Component[Output[Any]]]:
    return _ranked(component for component in OUTPUTS if suffix in component.kind.suffixes)


def _choices(suffix: str, suffixes: tuple[str, ...]) -> str:
    """What may be given instead, of the kind that was given where there is one."""
    kinds = [s for s in suffixes if s.startswith(NUMBERED) == suffix.startswith(NUMBERED) and s != FOLDER]
    return did_you_mean(suffix, kinds or suffixes)
