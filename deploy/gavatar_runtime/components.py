"""A registry of named components: the one mechanism by which a part of gavatar is swapped.

A component is a class (or function) with a typed dataclass of options; one decorator registers it::

    @DECODERS.register("mlp", config=MlpConfig, summary="the paper's 8-layer decoder")
    class MlpDecoder(nn.Module):
        def __init__(self, config: MlpConfig, *, in_channels: int): ...

This module needs only the standard library, so that the player and the training half share it.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar

from .errors import UserError, did_you_mean

T = TypeVar("T")


@dataclasses.dataclass
class NoOptions:
    """The options of a component that has none."""


@dataclasses.dataclass(frozen=True)
class Component(Generic[T]):
    """What a registry knows of one component.

    name: key in the registry and in overrides. factory: the class or function. config: its dataclass of options.
    summary: one line for `gavatar-list`. origin: the module that registered it. needs: what must be installed or
    supplied beyond the package ('' if nothing). missing: says why it cannot be had here, '' if it can.
    """

    name: str
    factory: Callable[..., T]
    config: type
    summary: str
    origin: str
    needs: str = ""
    missing: Callable[[], str] = str


class Registry(Generic[T]):
    """Components of one concept, by name.

    group: the Hydra group and the word used in messages, singular (`decoder`).
    """

    def __init__(self, group: str):
        self.group = group
        self._components: dict[str, Component[T]] = {}

    def register(
        self,
        name: str,
        *,
        config: type = NoOptions,
        summary: str = "",
        needs: str = "",
        missing: Callable[[], str] = str,
    ) -> Callable[[Callable[..., T]], Callable[..., T]]:
        """Register the decorated class or function as `name`; a duplicate replaces the former with a warning."""
        if not dataclasses.is_dataclass(config):
            raise TypeError(f"{self.group} '{name}': config must be a dataclass, got {config!r}")

        def decorate(factory: Callable[..., T]) -> Callable[..., T]:
            former = self._components.get(name)
            if former is not None and former.origin != factory.__module__:
                warnings.warn(
                    f"{self.group} '{name}' of {former.origin} is replaced by {factory.__module__}", stacklevel=2
                )
            doc = (factory.__doc__ or "").strip().splitlines()
            self._components[name] = Component(
                name, factory, config, summary or (doc[0] if doc else ""), factory.__module__, needs, missing
            )
            return factory

        return decorate

    def __iter__(self) -> Iterator[Component[T]]:
        return iter(sorted(self._components.values(), key=lambda c: c.name))

    def __contains__(self, name: str) -> bool:
        return name in self._components

    def names(self) -> list[str]:
        return sorted(self._components)

    def __getitem__(self, name: str) -> Component[T]:
        """The component called `name`; UserError with the choices and the nearest match if there is none."""
        try:
            return self._components[name]
        except KeyError:
            raise UserError(f"unknown {self.group} '{name}': {did_you_mean(name, self._components)}") from None

    def options(self, name: str, values: Mapping[str, Any] | None = None) -> Any:
        """A filled config dataclass for component `name` from plain `values` (a `name` key is ignored).

        Raises UserError for a key the component does not have.
        """
        component = self[name]
        fields = {f.name for f in dataclasses.fields(component.config)}
        values = {k: v for k, v in (values or {}).items() if k != "name"}
        for key in values:
            if key not in fields:
                raise UserError(f"{self.group} '{name}' has no option '{key}': {did_you_mean(key, fields)}")
        return component.config(**values)

    def build(self, name: str, values: Mapping[str, Any] | None = None, **context: Any) -> T:
        """Construct component `name` as `factory(options, **context)`."""
        return self[name].factory(self.options(name, values), **context)
