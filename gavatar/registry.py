"""gavatar's registries, one a concept, and how they are filled.

Three sources: the modules of the namespace package `gavatar_plugins`, the entry points of group `gavatar.plugins` of
any installed distribution, and the caller's own decorators. A module that fails to import is reported by name with its
cause, and the rest go on.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import importlib.metadata
import pkgutil
import warnings

from gavatar_runtime.motions import MOTIONS
from gavatar_runtime.registry import Component, NoOptions, Registry

BODIES: Registry = Registry("body")
ENCODERS: Registry = Registry("encoder")
DECODERS: Registry = Registry("decoder")
RASTERIZERS: Registry = Registry("rasterizer")
LOSSES: Registry = Registry("loss")
CAPTURES: Registry = Registry("capture_format")

REGISTRIES: tuple[Registry, ...] = (BODIES, ENCODERS, DECODERS, RASTERIZERS, LOSSES, CAPTURES, MOTIONS)
ENTRY_POINT_GROUP = "gavatar.plugins"
PLUGIN_ROOMS = ("bodies", "captures", "decoders", "encoders", "losses", "rasterizers")

__all__ = [
    "BODIES", "CAPTURES", "DECODERS", "ENCODERS", "LOSSES", "MOTIONS", "RASTERIZERS", "REGISTRIES",
    "Component", "NoOptions", "PluginFailure", "Registry", "fill_config_store", "load_plugins",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class PluginFailure:
    """A plugin that could not be imported: its module or entry point, and why."""

    plugin: str
    cause: str


def _builtin_modules() -> list[str]:
    """Every module in a room of the namespace package, wherever its portions are installed.

    Each room is asked by name, since neither walking folders nor `pkgutil.walk_packages` sees the rooms of a namespace
    package that is installed in editable mode.
    """
    rooms = [importlib.import_module(f"gavatar_plugins.{room}") for room in PLUGIN_ROOMS]
    return sorted(module.name for room in rooms for module in pkgutil.iter_modules(room.__path__, f"{room.__name__}."))


@functools.cache
def load_plugins() -> tuple[PluginFailure, ...]:
    """Import every plugin once; returns those that failed. Each failure is also a warning."""
    failures = []
    jobs = [(name, functools.partial(importlib.import_module, name)) for name in _builtin_modules()]
    for point in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP):
        jobs.append((f"{point.name} ({point.value})", point.load))
    for plugin, load in jobs:
        try:
            load()
        except Exception as error:  # whatever a plugin does at import must not take the others down
            failures.append(PluginFailure(plugin, f"{type(error).__name__}: {error}"))
            warnings.warn(f"plugin {plugin} was skipped: {failures[-1].cause}", stacklevel=2)
    return tuple(failures)


def fill_config_store() -> None:
    """Put every component's options into Hydra's ConfigStore, as group `<registry>` and option `<component>`.

    The stored node is the component's dataclass with a `name` field, so that `decoder=mlp decoder.width=64` composes
    and is type-checked with no YAML of its own. Losses and motions compose by name elsewhere and are not groups.
    """
    from hydra.core.config_store import ConfigStore

    store = ConfigStore.instance()
    for registry in (BODIES, ENCODERS, DECODERS, RASTERIZERS, CAPTURES):
        for component in registry:
            node = dataclasses.make_dataclass(
                f"{component.config.__name__}Node",
                [("name", str, dataclasses.field(default=component.name))],
                bases=(component.config,),
            )
            store.store(group=registry.group, name=component.name, node=node, provider="gavatar")
