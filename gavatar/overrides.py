"""Settings of a training as Hydra overrides: written from Python values, and checked before anything starts."""

from __future__ import annotations

import dataclasses
import importlib.resources
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from gavatar_runtime.errors import UserError, did_you_mean

from .config import FORMER_SETTINGS, TrainConfig, check, compose_config
from .registry import BODIES, CAPTURES, DECODERS, ENCODERS, POINTS, RASTERIZERS

REGISTERED = {registry.group: registry for registry in (BODIES, CAPTURES, DECODERS, ENCODERS, POINTS, RASTERIZERS)}
PLAIN = re.compile(r"[A-Za-z_][A-Za-z_0-9-]*")  # a string that Hydra's grammar takes without quotes
WORDS = ("null", "true", "false", "nan", "inf")  # that it takes for values of other kinds


def as_overrides(settings: Mapping[str, Any]) -> list[str]:
    """Settings as `gavatar-train` takes them: {"stage1": {"steps": 50}} and {"stage1.steps": 50} both give
    "stage1.steps=50"; the `name` of a component's dictionary chooses it.

    Values are None, booleans, numbers, strings, paths, and lists, dictionaries and dataclasses of these.
    Raises UserError for anything else.
    """
    overrides = []
    for key, value in settings.items():
        if not isinstance(value, Mapping):
            overrides.append(f"{key}={literal(value, key)}")
            continue
        options = dict(value)
        if key in REGISTERED and "name" in options:
            overrides.append(f"{key}={literal(options.pop('name'), key)}")
        overrides += [f"{key}.{name}={literal(option, f'{key}.{name}')}" for name, option in options.items()]
    return overrides


def from_overrides(arguments: Sequence[str]) -> dict[str, Any]:
    """The settings that a command line's overrides are, by their whole names: what `as_overrides` takes. Raises
    UserError for what gives no value, as a sweep or a deletion."""
    settings = {}
    for override in parse(arguments):
        odd = override.is_sweep_override() or override.is_delete() or override.is_add() or override.package is not None
        if odd or "${" in str(override.input_line):
            raise UserError(f"'{override.input_line}': give one value, KEY=VALUE")
        settings[override.key_or_group] = override.value()
    return settings


def literal(value: Any, key: str = "value") -> str:
    """A value as Hydra's grammar writes it. key: named in the UserError for a value that it has no words for."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if isinstance(value, np.generic):
        value = value.item()
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | os.PathLike):
        return _text(os.fspath(value))
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k, key)}: {literal(v, f'{key}.{k}')}" for k, v in value.items()) + "}"
    if isinstance(value, Iterable):
        return "[" + ", ".join(literal(item, key) for item in value) + "]"
    raise UserError(f"{key}: a {type(value).__name__} is no setting; give a number, a string, a list or a dictionary")


def _key(name: Any, above: str) -> str:
    if not isinstance(name, str) or not PLAIN.fullmatch(name) or name.lower() in WORDS:
        raise UserError(f"{above}: {name!r} is no name of a setting")
    return name


def _text(text: str) -> str:
    if PLAIN.fullmatch(text) and text.lower() not in WORDS:
        return text
    return QuotedString(text.replace("${", r"\${"), Quote.single).with_quotes()


def parse(arguments: Sequence[str]) -> list[Override]:
    """The overrides of a command line, flags left out. Raises UserError."""
    try:
        return OverridesParser.create().parse_overrides([a for a in arguments if not a.startswith("-")])
    except HydraException as error:
        raise UserError(one_sentence(error)) from None


def check_overrides(arguments: Sequence[str]) -> list[DictConfig]:
    """The configuration of every job of a command line, each checked, so that a mistake is one sentence before
    anything starts. Raises UserError."""
    overrides = parse([a for a in arguments if not a.startswith("hydra.")])
    try:
        jobs = BasicSweeper.split_arguments(overrides, None)[0]
        for choice in {override for job in jobs for override in job}:
            _check_choice(*choice.partition("=")[::2])
        composed = [compose_config(job) for job in jobs]
        for config in composed:
            check(config)
    except (HydraException, OmegaConfBaseException) as error:
        raise UserError(one_sentence(error)) from None
    return composed


def _check_choice(group: str, name: str) -> None:
    """UserError with the choices and the nearest where `name` is no component, and no preset, of a group."""
    folder = importlib.resources.files("gavatar.conf") / group
    if not PLAIN.fullmatch(group) or name.startswith("{") or (folder / f"{name}.yaml").is_file():
        return
    if group in REGISTERED:
        REGISTERED[group][name]
    elif folder.is_dir():
        known = [file.name.removesuffix(".yaml") for file in folder.iterdir() if file.name.endswith(".yaml")]
        raise UserError(f"unknown {group} '{name}': {did_you_mean(name, known)}")


def one_sentence(error: Exception) -> str:
    """Hydra's own message, shortened to what helps, with the nearest match where a key is unknown."""
    lines = [line.strip() for line in str(error.__cause__ or error).splitlines() if line.strip()]
    text = lines[0] if lines else type(error).__name__
    unknown = re.search(r"Key '(\w+)' is not in struct|Key '(\w+)' not in '(\w+)'", text)
    if not unknown:
        return " ".join(lines[:2])
    key = unknown.group(1) or unknown.group(2)
    if key in FORMER_SETTINGS:
        return f"{key} is no setting any more: {FORMER_SETTINGS[key]}; leave it out"
    full = next((line for line in lines if line.startswith("full_key")), "")
    where = full.removeprefix("full_key:").strip() or key
    if "." in where:
        return f"unknown setting '{where}': see the choices with gavatar-train --cfg job capture=DIR"
    return f"unknown setting '{where}': {did_you_mean(key, [f.name for f in dataclasses.fields(TrainConfig)])}"
