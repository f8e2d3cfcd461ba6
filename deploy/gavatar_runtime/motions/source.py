"""The registry of motion sources, and how a name or a file finds its own."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, cast

from ..components import Component, Registry
from ..errors import MissingFile, UserError, WrongValue, did_you_mean
from ..plugins import load_entry_points
from ..values.motion import Motion


class MotionSource(abc.ABC):
    """What a registered class derives from. A built-in motion is constructed as `factory(config)`; one of files or
    folders as `factory(config, path=path)`.

    suffixes: of the files it reads, lower case and with their dots. folder: it reads folders. facts: what a user wants
    to know of how the motion was read, by name, once it is.
    """

    suffixes: ClassVar[tuple[str, ...]] = ()
    folder: ClassVar[bool] = False
    facts: Mapping[str, str] = MappingProxyType({})

    @abc.abstractmethod
    def load(self) -> Motion:
        """The motion; UserError for whatever is wrong with the file or the options."""


@dataclasses.dataclass(frozen=True)
class MotionTraits:
    """varied: a built-in motion whose poses vary, so that what playing costs and loses can be measured by it.
    waits: it is what a person does while nothing is asked of them. whole: a built-in motion of the whole body, by which
    it is measured how an avatar looks in poses that nobody filmed."""

    varied: bool = False
    whole: bool = False
    waits: bool = False


MOTIONS: Registry[MotionSource] = Registry("motion", MotionTraits, base=MotionSource)


def read_motion(source: str | Path, **options: Any) -> Motion:
    """The motion called `source` (a built-in name, `turn`) or stored in the file `source`, by its suffix.

    options: of that motion's config dataclass. Plugins are imported only when no built-in source fits, so that playing
    stays free of whatever they import. Raises UserError for an unknown name or suffix, a missing file, a wrong option.
    """
    return motion_source(source, **options).load()


def motions_named(text: str) -> list[str]:
    """The motions that a list `walk,wave,dance.npz` names, built-in ones and files; a comma may be part of a file's
    name or of a folder's, where such a file is there. Empty places are left out."""
    parts, names = text.split(","), []
    while parts:
        # the longest row of parts that together name something on the disk, else the next part alone
        joined = (count for count in range(len(parts), 1, -1) if Path(",".join(parts[:count])).exists())
        count = next(joined, 1)
        names.append(",".join(parts[:count]))
        parts = parts[count:]
    return [name for name in names if name]


def read_motions(sources: Sequence[str | Path], **options: Any) -> list[Motion]:
    """Each as `read_motion` reads it, with those of the options that it has; one that none has is an error, as
    there."""
    found = [_find(source) for source in sources]
    if len(sources) < 2 or None in found:
        return [read_motion(source, **options) for source in sources]
    fields = [{field.name for field in dataclasses.fields(component.config)} for component in found if component]
    lost = {name: value for name, value in options.items() if not any(name in names for names in fields)}
    given = [{k: v for k, v in options.items() if k in names} | lost for names in fields]
    return [read_motion(source, **known) for source, known in zip(sources, given, strict=True)]


def motion_source(source: str | Path, **options: Any) -> MotionSource:
    """What reads that motion, as `read_motion` finds it."""
    component = _find(source)
    if component is None:
        load_entry_points()
        component = _find(source)
    if component is None:
        raise WrongValue(_unknown(str(source)))
    kind = _class_of(component)
    if not kind.suffixes and not kind.folder:
        return MOTIONS.build(component.name, options)
    path = Path(source)
    if not path.is_file() and not (kind.folder and path.is_dir()):
        if path.is_dir():
            raise UserError(f"motion file {path} is a directory")
        raise MissingFile(f"motion file {path} does not exist")
    return MOTIONS.build(component.name, options, path=path)


def built_in_motions() -> list[str]:
    """Names of the motions that need no file."""
    return [c.name for c in MOTIONS if not _class_of(c).suffixes and not _class_of(c).folder]


def _class_of(component: Component[MotionSource]) -> type[MotionSource]:
    return cast("type[MotionSource]", component.factory)  # the registry takes nothing else


def _find(source: str | Path) -> Component[MotionSource] | None:
    if isinstance(source, str) and source in MOTIONS and not _class_of(MOTIONS[source]).suffixes:
        return MOTIONS[source] if not _class_of(MOTIONS[source]).folder else None
    suffix = Path(source).suffix.lower()
    named = next((c for c in MOTIONS if suffix in _class_of(c).suffixes), None)
    if named is None and str(source) not in ("", ".") and Path(source).is_dir():
        return next((c for c in MOTIONS if _class_of(c).folder), None)
    return named


_BLENDER = "import it into Blender and export the armature as BVH (File > Export > Motion Capture)"
_TRACK = "track the person with a pose estimator (GVHMR, WHAM, 4D-Humans) and give the file that it writes"
_MARKERS = "places of markers are no rotations: fit a body to them (MoSh++ writes AMASS's .npz, SOMA labels them), or "
_MARKERS += "solve a skeleton and export it as BVH"
# What people have motions in, and how they become one that is read
_OTHER_FILES = {
    **dict.fromkeys((".fbx", ".glb", ".gltf", ".dae", ".usd", ".usda", ".usdc", ".usdz", ".blend"), _BLENDER),
    **dict.fromkeys((".vrma", ".vmd", ".anim", ".ma", ".mb", ".max", ".bip", ".htr", ".cal", ".mvnx"),
                    "open it in the program that wrote it, or in Blender, and export the skeleton as BVH"),
    **dict.fromkeys((".asf", ".amc"), "convert the pair .asf and .amc to BVH (amc2bvh, or Blender's importer)"),
    **dict.fromkeys((".c3d", ".trc", ".tvd", ".tsv", ".mot"), _MARKERS),
    **dict.fromkeys((".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".gif", ".png", ".jpg", ".jpeg"), _TRACK),
    **dict.fromkeys((".csv", ".txt", ".xlsx", ".dat"),
                    "a table does not say what its columns are: save them by name, poses (T, 3J), trans (T, 3) and "
                    "mocap_framerate, with numpy.savez"),
    **dict.fromkeys((".mat", ".h5", ".hdf5", ".parquet", ".feather"),
                    "save poses (T, 3J), trans (T, 3) and mocap_framerate from it with numpy.savez"),
    **dict.fromkeys((".zip", ".tar", ".gz", ".tgz", ".xz", ".bz2", ".7z", ".rar", ".zst"), "unpack it first"),
    **dict.fromkeys((".ply", ".obj", ".stl"), "a mesh says nothing of how joints turn: give the poses it was made of"),
    ".gavatar": "it is an avatar, not a motion: give it as the avatar and a motion by --motion",
}  # fmt: skip


def _unknown(source: str) -> str:
    suffix = Path(source).suffix.lower()
    if suffix in _OTHER_FILES:
        return f"motion '{source}' cannot be read, {suffix} is no format of motions here: {_OTHER_FILES[suffix]}"
    kinds = {c.name: _class_of(c) for c in MOTIONS}
    suffixes = sorted({s for kind in kinds.values() for s in kind.suffixes})
    hint = did_you_mean(source, built_in_motions())
    return f"unknown motion '{source}': give a file ({', '.join(suffixes)}) or a built-in name, {hint}"
