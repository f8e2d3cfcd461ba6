"""`--set KEY=VALUE` of the commands, and how options are written on them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from ..errors import Spelling, UserError, did_you_mean

GROUPS = ("motion", "rasterizer", "output")


def parse_settings(settings: Iterable[str]) -> dict[str, dict[str, Any]]:
    """`GROUP.KEY=VALUE` by group; numbers and true/false become what they look like."""
    options: dict[str, dict[str, Any]] = {group: {} for group in GROUPS}
    for setting in settings:
        match = re.fullmatch(r"(\w+)\.(\w+)=(.*)", setting)
        if match is None:
            raise UserError(f"--set {setting}: expected {' or '.join(f'{group}.KEY=VALUE' for group in GROUPS)}")
        group, key, text = match.groups()
        if group not in options:
            raise UserError(f"--set {setting}: unknown group '{group}': {did_you_mean(group, options)}")
        options[group][key] = _value(text)
    return options


def parse_options(settings: Iterable[str]) -> dict[str, Any]:
    """`KEY=VALUE` as options; values as in `parse_settings`."""
    options: dict[str, Any] = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or not key.isidentifier():
            raise UserError(f"--set {setting}: expected KEY=VALUE")
        options[key] = _value(text)
    return options


def _value(text: str) -> Any:
    """A whole number, a number, true or false where the text looks like one, else the text."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def as_flags(names: Iterable[str]) -> Spelling:
    """Options as a command has them: `budget_ms=3` is --budget-ms 3 where that is one of `names`, and `output.shown=3`
    is --set output.shown=3."""
    known = frozenset(names)

    def spelling(name: str, value: str) -> str:
        if name in known:
            return f"--{name.replace('_', '-')} {value}".rstrip()
        return as_settings("")(name, value) if "." in name else ""

    return spelling


def as_motion_options(name: str, value: str) -> str:
    """An option of a motion as commands have it: `rest=offsets` is --rest offsets, `fps=3` is --set motion.fps=3."""
    return as_flags(["rest"])(name, value) or as_settings("motion.")(name, value)


def as_settings(prefix: str) -> Spelling:
    """Options as settings: `fps=3` is --set motion.fps=3 with the prefix `motion.`."""
    return lambda name, value: f"--set {prefix}{name}={value or 'VALUE'}"
