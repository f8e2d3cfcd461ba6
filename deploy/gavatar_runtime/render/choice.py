"""Which rasterizer draws, by name, and with which of its options."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from collections.abc import Mapping
from typing import Any

from ..components import Registry
from ..plugins import load_entry_points
from . import rasterizers
from .rasterizers import Rasterizer

AUTO = "auto"  # the word for `best_rasterizer`


def build_rasterizer(
    name: str = AUTO,
    options: Mapping[str, Any] | None = None,
    *,
    threads: int | None = None,
    trained: Mapping[str, Any] | None = None,
) -> Rasterizer:
    """The player's rasterizer `name`, `auto` for the best that can be had.

    threads, trained: passed on to a rasterizer that has such options; `options` come before them. trained: the switches
    of a bundle's manifest, so that it is drawn as it was trained. Raises UserError for an unknown name or option.
    """
    registry = player_rasterizers()
    if name == AUTO:  # chosen by what is there, so that a mistaken option of it is still its own error
        name = best_rasterizer()
    if name not in registry:
        load_entry_points()
    fields = {field.name for field in dataclasses.fields(registry[name].config)}
    given = {**(trained or {}), **({} if threads is None else {"threads": threads})}
    return registry.build(name, {**{k: v for k, v in given.items() if k in fields}, **(options or {})})


def best_rasterizer() -> str:
    """The name of the player's rasterizer that is preferred of those that can be had here."""
    found = {c.name: c.default_traits for c in player_rasterizers() if not c.missing()}
    preference = {name: traits.preference for name, traits in found.items() if traits is not None}
    return max(preference, key=preference.__getitem__)


def player_rasterizers() -> Registry[Rasterizer]:
    """The registry of the player's rasterizers, filled by the modules of `gavatar_runtime.render.rasterizers`."""
    for module in pkgutil.iter_modules(rasterizers.__path__):
        importlib.import_module(f"{rasterizers.__name__}.{module.name}")
    return rasterizers.PLAYER_RASTERIZERS
