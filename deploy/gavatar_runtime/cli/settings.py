"""`--set KEY=VALUE` of the commands."""

from __future__ import annotations

import re
from typing import Any

from ..errors import UserError, did_you_mean


def parse_settings(settings: list[str]) -> dict[str, dict[str, Any]]:
    """`motion.KEY=VALUE` and `rasterizer.KEY=VALUE` by group; numbers and true/false become what they look like."""
    options: dict[str, dict[str, Any]] = {"motion": {}, "rasterizer": {}}
    for setting in settings:
        match = re.fullmatch(r"(\w+)\.(\w+)=(.*)", setting)
        if match is None:
            raise UserError(f"--set {setting}: expected motion.KEY=VALUE or rasterizer.KEY=VALUE")
        group, key, text = match.groups()
        if group not in options:
            raise UserError(f"--set {setting}: unknown group '{group}': {did_you_mean(group, options)}")
        options[group][key] = parse_value(text)
    return options


def parse_value(text: str) -> Any:
    """A whole number, a number, true or false where the text looks like one, else the text."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
