"""What a run directory says of where its files are, so that they are found again and recognised from elsewhere.

A run keeps each path twice: absolute, and as seen from its own folder (`from_here` in config.yaml). A capture that was
moved together with its runs, say since a folder above them was renamed, is found by the second. The capture is
recognised by what it holds (`capture_content`), wherever it lies.
"""

from __future__ import annotations

import copy
import dataclasses
import os
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from gavatar_runtime.components import Registry, path_options
from gavatar_runtime.errors import UserError
from gavatar_runtime.notes import Note

from ..config import FORMER_SETTINGS, TrainConfig, check
from ..registry import BODIES, CAPTURES, DECODERS, ENCODERS, LOSSES, POINTS, RASTERIZERS
from ..storage import atomic

CONFIG = "config.yaml"
FROM_HERE, CONTENT = "from_here", "capture_content"


@dataclasses.dataclass(frozen=True)
class WrittenRun:
    """The config.yaml of a run directory. seen: its paths from there, by the names of their settings. content: the
    fingerprint of the capture, '' in runs of earlier versions."""

    directory: Path
    config: TrainConfig
    seen: Mapping[str, Any]
    content: str = ""

    @classmethod
    def read(cls, directory: Path) -> WrittenRun:
        """UserError naming the file unless this version can read it."""
        path = directory / CONFIG
        try:
            written: Any = OmegaConf.load(path)
            seen = written.get(FROM_HERE) or {}
            for setting, now in FORMER_SETTINGS.items():
                if written.get(setting):
                    warnings.warn(f"{path}: {setting} is no setting any more: {now}", Note)
            return cls(directory, check(written), dict(seen), str(written.get(CONTENT) or ""))
        except UserError as error:
            raise UserError(f"{path}: {error}") from None
        except Exception as error:  # whatever YAML, OmegaConf or our dataclasses make of a file of another kind
            cause = (str(error).strip().splitlines() or [""])[0]
            raise UserError(
                f"{path} is not the configuration of a run of this version ({type(error).__name__}: {cause}): train "
                "with another out=DIR"
            ) from None

    def write(self) -> None:
        """Write config.yaml; a continued run is not asked to start afresh again."""
        plain = dataclasses.asdict(self.config) | {"overwrite": False}
        plain |= {FROM_HERE: dict(self.seen), CONTENT: self.content}
        with atomic(self.directory / CONFIG) as temporary:
            OmegaConf.save(OmegaConf.create(plain), temporary)

    def found(self) -> TrainConfig:
        """The configuration with paths that are no longer there replaced by what lies at the same place as seen from
        the directory."""
        placed = copy.deepcopy(self.config)
        for node, key, name in path_settings(placed):
            other = self._from_here(name)
            if other and not os.path.exists(node[key]) and os.path.exists(other):
                node[key] = other
        return placed

    def recognised(self, given: TrainConfig, content: str) -> TrainConfig:
        """The configuration with the paths of `given`, which are absolute, where both mean the same: the same place,
        or of captures the same content."""
        placed, asked = copy.deepcopy(self.config), {name: node[key] for node, key, name in path_settings(given)}
        for node, key, name in path_settings(placed):
            same = asked.get(name) in (os.path.realpath(node[key]), self._from_here(name))
            if same or (name == "capture" and self.content == content):
                node[key] = asked[name]
        return placed

    def _from_here(self, name: str) -> str:
        return os.path.realpath(self.directory / str(self.seen[name])) if self.seen.get(name) else ""


def absolute(config: TrainConfig) -> TrainConfig:
    """The configuration with every path absolute and without links, as counted from the working directory."""
    placed = copy.deepcopy(config)
    for node, key, _ in path_settings(placed):
        node[key] = os.path.realpath(os.path.expanduser(node[key]))
    return placed


def from_here(config: TrainConfig, directory: Path) -> dict[str, str]:
    """The paths of an absolute configuration as seen from a run's directory, by the names of their settings."""
    here, seen = os.path.realpath(directory), {}
    for node, key, name in path_settings(config):
        try:
            seen[name] = os.path.relpath(node[key], here)
        except ValueError:  # another drive of Windows
            continue
    return seen


def path_settings(config: TrainConfig) -> Iterator[tuple[dict[str, Any], str, str]]:
    """(where it is held, its key there, its whole name) of every setting that is a path and not empty."""
    if config.capture:
        yield vars(config), "capture", "capture"
    nodes: list[tuple[Registry, str, str, Any]] = [
        (registry, registry.group, "", getattr(config, registry.group))
        for registry in (BODIES, POINTS, ENCODERS, DECODERS, RASTERIZERS, CAPTURES)
    ]
    nodes += [(LOSSES, "losses.", name, node) for name, node in config.losses.items()]
    for registry, group, loss, node in nodes:
        if isinstance(node, dict):
            for option in path_options(registry[loss or node["name"]].config):
                if node.get(option):
                    yield node, option, f"{group}{loss}.{option}"
