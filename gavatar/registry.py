"""gavatar's registries, one a concept, and how they are filled.

Three sources: the modules of the namespace package `gavatar_plugins`, the entry points of group `gavatar.plugins` of
any installed distribution, and the caller's own decorators. A module that fails to import is reported by name with its
cause, and the rest go on.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import importlib.metadata
import pkgutil
import typing
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from gavatar_runtime.components import Component, NoOptions, Registry
from gavatar_runtime.conversions import CONVERSIONS
from gavatar_runtime.decoding.pose_inputs import Shape, input_shapes
from gavatar_runtime.live.drivers import DRIVERS
from gavatar_runtime.motions import MOTIONS
from gavatar_runtime.notes import Note
from gavatar_runtime.play.outputs import OUTPUTS

from .optional import extra_of, install_command


@dataclasses.dataclass(frozen=True)
class BodyTraits:
    """chooses: it stands for others: its factory has `choose(options, capture)`, which gives the node of the body for a
    capture. capture_name: what a capture calls it, as its `body_model`, '' for the component's own name. shipped: it
    comes with the package; a person is fitted with it where no other is asked for."""

    chooses: bool = False
    capture_name: str = ""
    shipped: bool = False


@dataclasses.dataclass(frozen=True)
class EncoderTraits:
    """static: it is no network; the avatar looks alike in every pose. inputs: what it looks at, in the order of its
    arguments, with the shapes of one pose's (`gavatar_runtime.decoding.pose_inputs.input_shapes`). prepares: its
    `prepare` is called once before its first training step. not_exported: why an avatar with such an encoder is not
    exported, '' if it is."""

    static: bool = False
    inputs: dict[str, Shape] = dataclasses.field(default_factory=lambda: input_shapes("positional_map"))
    prepares: bool = False
    not_exported: str = ""


@dataclasses.dataclass(frozen=True)
class DecoderTraits:
    """counts_steps: its `on_step` is called before each training step of stage 1. mixed_precision: it may be trained
    under autocast to bfloat16 and gives float32 even then. not_exported: why an avatar with such a decoder is not
    exported, '' if it is. finds_floor: its buffer `floor`, the smallest scale in units of the spacing, is set in the
    course of stage 1 by what shows through."""

    counts_steps: bool = False
    mixed_precision: bool = False
    not_exported: str = ""
    finds_floor: bool = False


@dataclasses.dataclass(frozen=True)
class RasterizerTraits:
    """differentiable: gradients reach means, scales, colors, opacities, quaternions and background from color, alpha
    and depth. devices: types of torch's devices whose tensors it draws. widens: every splat gains the variance of the
    low-pass filter, so that a camera with finer pixels than training's needs `gavatar_runtime.render.widening`.
    resolution: share of the image's sides that it draws at. played_with: those of its options that a bundle keeps and
    is played with, since they change the picture."""

    differentiable: bool = True
    devices: tuple[str, ...] = ("cpu", "cuda")
    widens: bool = True
    resolution: float = 1.0
    played_with: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class LossTraits:
    """judges_poses: it says how well a pose fits an image, at a cost that fitting poses of a trained avatar can bear.
    in_progress_bar: its value is shown while training."""

    judges_poses: bool = True
    in_progress_bar: bool = False


@dataclasses.dataclass(frozen=True)
class PointTraits:
    """texels: its points are texels of the UV atlas, so that a level may name a side of it (`uv`) as well, and each
    number of points is a sampling of its own; else a smaller number is a prefix of a larger. former: runs that say
    nothing of points were trained with it."""

    texels: bool = False
    former: bool = False


@dataclasses.dataclass(frozen=True)
class CaptureTraits:
    """chooses: it stands for others: its factory has `choose(options, path)`, which gives the node of the layout that a
    folder has."""

    chooses: bool = False


BODIES: Registry = Registry("body", BodyTraits)
ENCODERS: Registry = Registry("encoder", EncoderTraits)
DECODERS: Registry = Registry("decoder", DecoderTraits)
RASTERIZERS: Registry = Registry("rasterizer", RasterizerTraits)
LOSSES: Registry = Registry("loss", LossTraits)
POINTS: Registry = Registry("points", PointTraits)
CAPTURES: Registry = Registry("capture_format", CaptureTraits)
TIERS: Registry = Registry("tier")

REGISTRIES: tuple[Registry, ...] = (
    BODIES, POINTS, ENCODERS, DECODERS, RASTERIZERS, LOSSES, CAPTURES, MOTIONS, TIERS, OUTPUTS, CONVERSIONS, DRIVERS,
)  # fmt: skip
ENTRY_POINT_GROUP = "gavatar.plugins"
PLUGIN_ROOMS = ("bodies", "captures", "decoders", "drivers", "encoders", "losses", "points", "rasterizers", "tiers")

__all__ = [
    "BODIES", "CAPTURES", "CONVERSIONS", "DECODERS", "DRIVERS", "ENCODERS", "LOSSES", "MOTIONS", "OUTPUTS", "POINTS",
    "RASTERIZERS", "REGISTRIES", "TIERS", "BodyTraits", "CaptureTraits", "Component", "DecoderTraits", "EncoderTraits",
    "LossTraits", "NoOptions", "PluginFailure", "PointTraits", "RasterizerTraits", "Registry", "fill_config_store",
    "load_plugins", "load_room", "resolve",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class PluginFailure:
    """A plugin that could not be imported: its module or entry point, and why. extra: the extra of gavatar that would
    mend it, '' when the cause is another."""

    plugin: str
    cause: str
    extra: str = ""


def _room(name: str) -> ModuleType:
    """The package of a room. An editable install knows the rooms of the day it was made: a later one is found beside
    this library."""
    try:
        return importlib.import_module(f"gavatar_plugins.{name}")
    except ModuleNotFoundError:
        beside = Path(__file__).resolve().parents[1] / "gavatar_plugins"
        if not (beside / name).is_dir():
            raise
        namespace = importlib.import_module("gavatar_plugins")
        namespace.__path__ = [*namespace.__path__, str(beside)]
        return importlib.import_module(f"gavatar_plugins.{name}")


def _builtin_modules() -> list[str]:
    """Every module in a room of the namespace package, wherever its portions are installed.

    Each room is asked by name, since neither walking folders nor `pkgutil.walk_packages` sees the rooms of a namespace
    package that is installed in editable mode.
    """
    rooms = [_room(room) for room in PLUGIN_ROOMS]
    return sorted(module.name for room in rooms for module in pkgutil.iter_modules(room.__path__, f"{room.__name__}."))


def load_room(name: str) -> None:
    """Import what the room of that name registers, for whoever needs nothing else; what fails there is told by
    `load_plugins` alone."""
    room = _room(name)
    for module in pkgutil.iter_modules(room.__path__, f"{room.__name__}."):
        with contextlib.suppress(Exception):
            importlib.import_module(module.name)


@functools.cache
def load_plugins() -> tuple[PluginFailure, ...]:
    """Import every plugin once; returns those that failed.

    Each failure is also a warning, except that plugins which want an extra share one warning an extra: in a base
    install they are many and nothing is wrong with them.
    """
    failures = []
    jobs: list[tuple[str, Callable[[], Any]]] = []
    jobs += [(name, functools.partial(importlib.import_module, name)) for name in _builtin_modules()]
    for point in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP):
        source = f", from {point.dist.name}" if point.dist else ""
        jobs.append((f"{point.name} ({point.value}{source})", point.load))
    for plugin, load in jobs:
        try:
            load()
        except (Exception, SystemExit) as error:  # whatever a plugin does at import must not take the others down
            failures.append(_failure(plugin, error))
    _warn(failures)
    return tuple(failures)


def _failure(plugin: str, error: BaseException) -> PluginFailure:
    missing = error.name if isinstance(error, ModuleNotFoundError) else None
    extra = extra_of(missing)
    if extra is None:
        return PluginFailure(plugin, f"{type(error).__name__}: {error}")
    return PluginFailure(plugin, f"needs {missing}: {install_command(extra)}", extra)


def _warn(failures: list[PluginFailure]) -> None:
    for failure in failures:
        if not failure.extra:
            warnings.warn(f"plugin {failure.plugin} was skipped: {failure.cause}", Note, stacklevel=3)
    for extra in sorted({failure.extra for failure in failures} - {""}):
        skipped = [failure.plugin for failure in failures if failure.extra == extra]
        warnings.warn(
            f"plugins were skipped, {install_command(extra)} brings them: {', '.join(skipped)}", Note, stacklevel=3
        )


def fill_config_store() -> None:
    """Put every component's options into Hydra's ConfigStore, as group `<registry>` and option `<component>`.

    The stored node is the component's dataclass with a `name` field, so that `decoder=mlp decoder.width=64` composes
    and is type-checked with no YAML of its own. Losses and motions compose by name elsewhere and are not groups. A
    component whose options Hydra cannot hold is named in a warning, and the rest go on.
    """
    from hydra.core.config_store import ConfigStore
    from omegaconf.errors import OmegaConfBaseException

    store = ConfigStore.instance()
    for registry in (BODIES, POINTS, ENCODERS, DECODERS, RASTERIZERS, CAPTURES):
        for component in registry:
            try:
                store.store(group=registry.group, name=component.name, node=_node(component), provider="gavatar")
            except (OmegaConfBaseException, TypeError, NameError) as error:
                cause = str(error).strip().splitlines()[0]
                warnings.warn(f"{registry.group} '{component.name}' cannot be configured: {cause}", Note, stacklevel=2)


def _node(component: Component) -> type:
    """The component's options and its name as one plain dataclass: Hydra would make a frozen one read-only."""
    hints = typing.get_type_hints(component.config)
    fields = [("name", str, dataclasses.field(default=component.name))]
    for field in dataclasses.fields(component.config):
        if not field.init or field.name == "name":
            continue
        if field.default_factory is not dataclasses.MISSING:
            value = dataclasses.field(default_factory=field.default_factory)
        else:  # OmegaConf's word for a value that the user owes
            value = dataclasses.field(default="???" if field.default is dataclasses.MISSING else field.default)
        fields.append((field.name, hints[field.name], value))
    return dataclasses.make_dataclass(f"{component.config.__name__}Node", fields)


def split_node(node: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """A composed component node -> its name and its options."""
    return node["name"], {k: v for k, v in node.items() if k != "name"}


def resolve(registry: Registry, node: dict[str, Any], context: Any) -> dict[str, Any]:
    """The node itself or, of a component that stands for others, the node of the one that it chooses for `context`
    (bodies: a capture; captures: a folder)."""
    name, options = split_node(node)
    if not registry.traits(name, options).chooses:
        return node
    return registry[name].kind.choose(registry.options(name, options), context)
