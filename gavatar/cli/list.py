"""`gavatar-list [GROUP] [--json]`: every registered component, its options, where it comes from, what it needs."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import importlib.metadata
import json
import sys
import textwrap
import warnings
from typing import Any

from gavatar_runtime.components import Component
from gavatar_runtime.errors import UserError, did_you_mean, exit_cleanly
from gavatar_runtime.live.drivers import ENTRY_POINT_GROUP as DRIVERS_GROUP
from gavatar_runtime.plugins import load_entry_points

from ..optional import install_command
from ..registry import REGISTRIES, PluginFailure, load_plugins

DESCRIPTION = "List every registered component: options with types and defaults, origin, what it needs."
EPILOG = """examples
  gavatar-list                 everything
  gavatar-list decoder         the decoders
  gavatar-list decoder --json  the same for programs

An option is set as GROUP.OPTION=VALUE: gavatar-train capture=DIR decoder=mlp decoder.head_width=32
"""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "gavatar-list", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("group", nargs="?", metavar="GROUP", help=", ".join(r.group for r in REGISTRIES))
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def option_rows(config: type) -> list[dict[str, Any]]:
    """name, type, default and whether a value is required, of each field of an options dataclass, in its order."""
    rows = []
    for field in dataclasses.fields(config):
        required = field.default is field.default_factory is dataclasses.MISSING
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        else:
            default = None if required else field.default
        kind = field.type if isinstance(field.type, str) else _type_name(field.type)
        rows.append({"name": field.name, "type": kind, "default": default, "required": required})
    return rows


def _type_name(kind: Any) -> str:
    return kind.__name__ if isinstance(kind, type) else str(kind)


@functools.cache
def distribution_of(module: str) -> str:
    """Name and version of the distribution that `module` was installed by, '' if it cannot be told.

    Several distributions may share the namespace `gavatar_plugins`: there the one that holds the module's file.
    """
    owners = sorted(set(importlib.metadata.packages_distributions().get(module.partition(".")[0], ())))
    if len(owners) > 1 or not owners:
        owners = _holders_of_file(module) or owners
    return f"{owners[0]} {importlib.metadata.version(owners[0])}" if len(owners) == 1 else ""


def _holders_of_file(module: str) -> list[str]:
    source = sys.modules[module].__file__ if module in sys.modules else None
    tail = module.replace(".", "/") + ".py"
    held = []
    for distribution in importlib.metadata.distributions():
        for file in distribution.files or ():
            if str(file) == tail and str(file.locate()) == source:
                held.append(distribution.name)
    if not held and module.partition(".")[0] in ("gavatar", "gavatar_plugins", "gavatar_runtime"):
        return ["gavatar"]  # an editable install lists no files
    return held


def describe(component: Component) -> dict[str, Any]:
    """What `--json` says of one component."""
    return {
        "name": component.name,
        "summary": component.summary,
        "default": component.default,
        "origin": component.origin,
        "distribution": distribution_of(component.origin),
        "needs": component.needs,
        "missing": component.missing(),
        "traits": {} if component.default_traits is None else dataclasses.asdict(component.default_traits),
        "options": option_rows(component.config),
    }


def catalogue(group: str | None) -> dict[str, list[dict[str, Any]]]:
    """The components of `group`, or of every group; UserError for an unknown group."""
    registries = {registry.group: registry for registry in REGISTRIES}
    if group is not None:
        if group not in registries:
            raise UserError(f"unknown group '{group}': {did_you_mean(group, registries)}")
        registries = {group: registries[group]}
    return {name: [describe(component) for component in registry] for name, registry in registries.items()}


def _print_group(group: str, rows: list[dict[str, Any]]) -> None:
    print(group)
    (registry,) = (registry for registry in REGISTRIES if registry.group == group)
    usual = dataclasses.asdict(registry.usual_traits)
    width = max((len(row["name"]) for row in rows), default=0)
    for row in rows:
        origin = ", ".join(filter(None, (row["origin"], row["distribution"])))
        print(f"  {row['name']:{width}}  {row['summary']}")
        print(f"  {'':{width}}  from {origin}")
        if row["needs"]:
            print(f"  {'':{width}}  needs {row['needs']}")
        if row["missing"]:
            print(f"  {'':{width}}  not here: {row['missing']}")
        said = [f"{name}={value!r}" for name, value in row["traits"].items() if value != usual[name]]
        said += ["taken where no other is asked for"] if row["default"] else []
        if said:
            print(f"  {'':{width}}  {', '.join(said)}")
        options = [
            f"{o['name']}: {o['type']}" + (", required" if o["required"] else f" = {o['default']!r}")
            for o in row["options"]
        ]
        for option in options:
            print(f"  {'':{width}}    {option}")
    if not rows:
        print("  (none)")
    print()


def _print_failures(failures: tuple[PluginFailure, ...]) -> None:
    for extra in sorted({failure.extra for failure in failures} - {""}):
        names = ", ".join(failure.plugin for failure in failures if failure.extra == extra)
        print(f"available after {install_command(extra)}:")
        print(
            textwrap.fill(names, 118, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False), end="\n\n"
        )
    broken = [failure for failure in failures if not failure.extra]
    if broken:
        print("failed to import:")
        for failure in broken:
            print(f"  {failure.plugin}: {failure.cause}")


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    with warnings.catch_warnings(record=True) as caught:  # failures are printed below; anything else is passed on
        warnings.simplefilter("always")
        failures = load_plugins()
        load_entry_points(DRIVERS_GROUP)
    for warning in caught:
        if " skipped" not in str(warning.message):
            print(f"warning: {warning.message}", file=sys.stderr)
    groups = catalogue(arguments.group)
    if arguments.json:
        print(
            json.dumps({"groups": groups, "failures": [dataclasses.asdict(f) for f in failures]}, indent=2, default=str)
        )
        return 0
    for group, rows in groups.items():
        _print_group(group, rows)
    _print_failures(failures)
    return 0


if __name__ == "__main__":
    main()
