"""Many trainings of one command, `gavatar-train --multirun`: which captures are meant, and where each run goes."""

from __future__ import annotations

import fnmatch
import glob
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from hydra.core.override_parser.types import Glob, Override, QuotedString

from gavatar_runtime.errors import UserError

from ..capture.opening import capture_format
from ..overrides import literal, parse

FLAGS = ("-m", "--multirun")


def asks_for_many(arguments: Sequence[str]) -> bool:
    """Whether a command line is one of many trainings."""
    return any(a in FLAGS or a.lower().replace("'", "") == "hydra.mode=multirun" for a in arguments)


def refuse_pattern(arguments: Sequence[str]) -> None:
    """UserError where a single training is given a pattern as its capture."""
    for override in parse(_settings(arguments)):
        if override.key_or_group == "capture" and _patterns(override) is not None:
            raise UserError(
                f"{override.input_line} may be several captures: add --multirun to train one avatar of each"
            )


def sweep_arguments(arguments: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """The arguments as Hydra takes them, the flag first, and the name of each capture's directory if they are swept.

    A capture may be a list (`capture=a,b`), a pattern (`capture='captures/*'`), or `glob(...)` of patterns: of what a
    pattern finds, the folders that are captures. The run of a capture lies at OUT/NAME, or at OUT/NAME/SETTINGS where
    other settings differ between the jobs as well; OUT is `runs` unless `out=` says otherwise.
    """
    rest = [a for a in arguments if a not in FLAGS]
    overrides = parse(_settings(rest))
    captures = [o for o in overrides if o.key_or_group == "capture"]
    paths = _captures(captures[-1]) if captures else None
    fixed = {o.get_key_element().lstrip("+~") for o in overrides if not o.is_sweep_override()}
    names: dict[str, str] = {}
    if paths is not None:
        names = distinct_names(paths)
        rest = [a for a in rest if not a.startswith("capture=")] + [f"capture={','.join(map(literal, paths))}"]
        swept = {o.get_key_element() for o in overrides if o.is_sweep_override()} - {"capture"}
        place = "${run_name:${capture}}" + ("/${hydra.job.override_dirname}" if swept else "")
        rest = [f"hydra.sweep.subdir='{place}'", *rest]
        if "out" not in fixed:
            rest = ["hydra.sweep.dir=runs", *rest]
        fixed.add("capture")
    return ["--multirun", f"hydra.job.config.override_dirname.exclude_keys=[{','.join(sorted(fixed))}]", *rest], names


def distinct_names(paths: Sequence[str]) -> dict[str, str]:
    """The folder's own name for each path, with the names of folders above it where two are alike."""
    parts = {path: Path(path).resolve().parts[1:] for path in paths}
    depth = dict.fromkeys(paths, 1)
    while True:
        names = {path: "_".join(parts[path][-depth[path] :]) for path in paths}
        alike = {name for name, count in Counter(names.values()).items() if count > 1}
        longer = [path for path in paths if names[path] in alike and depth[path] < len(parts[path])]
        if not longer:
            return names
        for path in longer:
            depth[path] += 1


def _settings(arguments: Sequence[str]) -> list[str]:
    return [a for a in arguments if not a.startswith(("-", "hydra.", "hydra/"))]


def _captures(override: Override) -> list[str] | None:
    """The captures of a swept override, None when it is one as it stands."""
    patterns = _patterns(override)
    if patterns is None:
        return None
    paths: list[str] = []
    for pattern in patterns:
        paths += _found(pattern) if is_pattern(pattern) else [pattern]
    value = override.value()
    if isinstance(value, Glob):
        paths = [p for p in paths if not any(fnmatch.fnmatch(p, e) for e in value.exclude)]
    if not paths:
        raise UserError(f"{override.input_line}: no capture is left")
    first: dict[Path, str] = {}
    for path in paths:
        other = first.setdefault(Path(path).resolve(), path)
        if other is not path:
            raise UserError(f"{override.input_line}: {path} is the same capture as {other}; name it once")
    return paths


def _patterns(override: Override) -> list[str] | None:
    """The elements of a sweep over captures, None for a single folder."""
    value = override.value()
    if isinstance(value, Glob):
        return value.include
    if override.is_sweep_override():
        return [e.text if isinstance(e, QuotedString) else str(e) for e in override.sweep_iterator()]
    return [value] if isinstance(value, str) and is_pattern(value) else None


def is_pattern(text: str) -> bool:
    """Whether a path stands for those that it matches."""
    return glob.has_magic(text) and not Path(text).exists()


def _found(pattern: str) -> list[str]:
    """The captures that a pattern matches; other folders are named on stderr. Raises UserError when there are none."""
    captures, others = [], []
    for path in sorted(glob.glob(pattern)):
        if not Path(path).is_dir():
            continue
        try:
            capture_format(Path(path))
            captures.append(path)
        except UserError:
            others.append(path)
    if not captures:
        raise UserError(f"capture={pattern} matches no capture")
    if others:
        print(f"passed over, no captures: {', '.join(others)}", file=sys.stderr)
    return captures
