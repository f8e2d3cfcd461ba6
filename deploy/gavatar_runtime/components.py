"""A registry of named components: the one mechanism by which a part of gavatar is swapped.

A component is a class (or function) with a typed dataclass of options; one decorator registers it::

    @DECODERS.register("mlp", config=MlpConfig, summary="the paper's 8-layer decoder")
    class MlpDecoder(nn.Module):
        def __init__(self, config: MlpConfig, *, in_channels: int): ...

What a component can, other code asks it instead of knowing its name: a registry has a dataclass of traits, each with
its default, and a component gives its own where they differ.

This module needs only the standard library, so that the player and the training half share it.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar

from .errors import WrongValue, did_you_mean
from .notes import Note

T = TypeVar("T")


@dataclasses.dataclass
class NoOptions:
    """The options of a component that has none."""


def path_option(default: str = "") -> Any:
    """A field of a dataclass of options that is the path of a file or folder, '' for none: a run keeps it so that it is
    found from another working directory as well."""
    return dataclasses.field(default=default, metadata={"path": True})


def path_options(config: type) -> list[str]:
    """The names of the options that `path_option` made."""
    return [field.name for field in dataclasses.fields(config) if field.metadata.get("path")]


@dataclasses.dataclass(frozen=True)
class NoTraits:
    """The traits of components of which nothing is asked."""


@dataclasses.dataclass(frozen=True)
class Component(Generic[T]):
    """What a registry knows of one component.

    name: key in the registry and in overrides. factory: the class or function. config: its dataclass of options.
    summary: one line for `gavatar-list`. origin: the module that registered it. needs: what must be installed or
    supplied beyond the package ('' if nothing). missing: says why it cannot be had here, '' if it can. traits: from
    its filled options to what it can with them. default: it is the one that is taken where none is asked for.
    """

    name: str
    factory: Callable[..., T]
    config: type
    summary: str
    origin: str
    needs: str = ""
    missing: Callable[[], str] = str
    traits: Callable[[Any], Any] = lambda options: NoTraits()
    default: bool = False

    @property
    def kind(self) -> Any:
        """The class itself, which is asked for what it says beside its contract (`needs`, `choose`)."""
        return self.factory

    @property
    def default_traits(self) -> Any | None:
        """What it can with the defaults of its options, None where some have no default."""
        fields = dataclasses.fields(self.config)
        owed = any(field.default is field.default_factory is dataclasses.MISSING for field in fields)
        return None if owed else self.traits(self.config())


class Registry(Generic[T]):
    """Components of one concept, by name.

    group: the Hydra group and the word used in messages, singular (`decoder`). traits: the frozen dataclass of what its
    components can, every field with its default. base: the class that each component derives from, if it must.
    """

    def __init__(self, group: str, traits: type = NoTraits, *, base: type | None = None):
        self.group, self._traits, self._base = group, traits, base
        self._components: dict[str, Component[T]] = {}

    def register(
        self,
        name: str,
        *,
        config: type = NoOptions,
        summary: str = "",
        needs: str = "",
        missing: Callable[[], str] = str,
        traits: Any = None,
        default: bool = False,
    ) -> Callable[[Callable[..., T]], Callable[..., T]]:
        """Register the decorated class or function as `name`; a duplicate replaces the former with a warning.

        traits: what it can, where that differs from the registry's defaults, or a function from its filled options to
        that. default: it is the one that is taken where none is asked for; a registry has one at most.
        """
        if not dataclasses.is_dataclass(config):
            raise TypeError(f"{self.group} '{name}': config must be a dataclass, got {config!r}")
        others = [c.name for c in self if c.default and c.name != name]
        if default and others:
            raise ValueError(f"{self.group} '{name}' cannot be the default: that is '{others[0]}'")
        can = self._as_function(name, traits)

        def decorate(factory: Callable[..., T]) -> Callable[..., T]:
            if self._base is not None and not (isinstance(factory, type) and issubclass(factory, self._base)):
                raise TypeError(f"{self.group} '{name}' is no class derived from {self._base.__name__}")
            former = self._components.get(name)
            if former is not None and former.origin != factory.__module__:
                warnings.warn(
                    f"{self.group} '{name}' of {former.origin} is replaced by {factory.__module__}", Note, stacklevel=2
                )
            doc = (factory.__doc__ or "").strip().splitlines()
            self._components[name] = Component(
                name,
                factory,
                config,
                summary or (doc[0] if doc else ""),
                factory.__module__,
                needs,
                missing,
                can,
                default,
            )
            return factory

        return decorate

    def _as_function(self, name: str, traits: Any) -> Callable[[Any], Any]:
        """The traits of `register` as a function of options."""
        if callable(traits):
            return traits
        given = self.usual_traits if traits is None else traits
        if not isinstance(given, self._traits):
            raise TypeError(f"{self.group} '{name}': traits must be {self._traits.__name__}, got {traits!r}")
        return lambda options: given

    def forget(self, name: str) -> None:
        """Take component `name` out again, if it is there."""
        self._components.pop(name, None)

    def __iter__(self) -> Iterator[Component[T]]:
        return iter(sorted(self._components.values(), key=lambda c: c.name))

    def __contains__(self, name: str) -> bool:
        return name in self._components

    def names(self) -> list[str]:
        return sorted(self._components)

    def having(self, **wanted: Any) -> list[str]:
        """Names of the components that have these traits with the defaults of their options."""
        found = []
        for component in self:
            traits = component.default_traits
            if traits is not None and all(getattr(traits, key) == value for key, value in wanted.items()):
                found.append(component.name)
        return found

    @property
    def default(self) -> str:
        """The name of the component that is taken where none is asked for; WrongValue where there is no such one."""
        for component in self:
            if component.default:
                return component.name
        raise WrongValue(f"no {self.group} is the default: name one, {did_you_mean('', self._components)}")

    @property
    def usual_traits(self) -> Any:
        """What a component can that says nothing else."""
        return self._traits()

    def __getitem__(self, name: str) -> Component[T]:
        """The component called `name`; WrongValue with the choices and the nearest match if there is none."""
        try:
            return self._components[name]
        except KeyError:
            raise WrongValue(f"unknown {self.group} '{name}': {did_you_mean(name, self._components)}") from None

    def options(self, name: str, values: Mapping[str, Any] | None = None) -> Any:
        """A filled config dataclass for component `name` from plain `values` (a `name` key is ignored).

        Raises WrongValue for a key the component does not have.
        """
        component = self[name]
        fields = {f.name for f in dataclasses.fields(component.config)}
        values = {k: v for k, v in (values or {}).items() if k != "name"}
        for key in values:
            if key not in fields:
                raise WrongValue(f"{self.group} '{name}' has no option '{key}': {did_you_mean(key, fields)}")
        return component.config(**values)

    def build(self, name: str, values: Mapping[str, Any] | None = None, **context: Any) -> T:
        """Construct component `name` as `factory(options, **context)`."""
        return self[name].factory(self.options(name, values), **context)

    def traits(self, name: str, values: Mapping[str, Any] | None = None) -> Any:
        """What component `name` can with these options, an instance of the registry's dataclass of traits."""
        return self[name].traits(self.options(name, values))
