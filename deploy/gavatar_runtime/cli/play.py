"""`gavatar-play`: an avatar bundle in motion, into a file. Loads no torch."""

from __future__ import annotations

import dataclasses
import sys
from time import perf_counter
from typing import TYPE_CHECKING, Any

from ..errors import WrongValue, exit_cleanly, options_spelled, spelled
from .play_arguments import parser
from .settings import as_flags, as_motion_options, parse_settings

if TYPE_CHECKING:
    from ..play.company import Companion, Place

OURS = (
    "avatar", "motion", "out", "rest", "set", "json", "quiet", "at", "with_avatar", "with_motion", "with_tier",
)  # fmt: skip  # the other arguments are keywords of `perform`


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    start = perf_counter()
    arguments = vars(parser().parse_args(argv))
    settings = parse_settings(arguments["set"])
    if arguments["rest"]:
        settings["motion"]["rest"] = arguments["rest"]

    from ..formats.files import write_json
    from ..motions import MOTIONS, motions_named, read_motions
    from ..play.performance import perform
    from .play_report import FrameBar, as_json, table

    quiet, flags = arguments["quiet"], as_flags(arguments)
    with options_spelled(as_motion_options):  # before those of `perform`, whose --fps is another
        motions = read_motions(motions_named(arguments["motion"] or MOTIONS.default), **settings["motion"])
    motions = [
        dataclasses.replace(motion, notes=tuple(spelled(note, as_motion_options) for note in motion.notes))
        for motion in motions
    ]
    earlier = perf_counter() - start
    with options_spelled(flags):
        report = perform(
            arguments["avatar"],
            motions,
            arguments["out"],
            rasterizer_options=settings["rasterizer"] or None,
            output_options=settings["output"] or None,
            place=_place(arguments["at"]),
            beside=_companions(arguments, settings["motion"]),
            progress=None if quiet else FrameBar(),
            tell=None if quiet else lambda note: print(f"note: {spelled(note, flags)}", file=sys.stderr),
            **{name: value for name, value in arguments.items() if name not in OURS},
        )
    notes = tuple(spelled(note, flags) for note in report.notes)
    report = dataclasses.replace(report, ready_seconds=earlier + report.ready_seconds, notes=notes)
    if arguments["json"]:
        write_json(arguments["json"], as_json(report))
    if not quiet:
        print(table(report))
    return 0


def _place(numbers: tuple[float, float, float] | None) -> Place | None:
    from ..play.company import Place

    return Place(*numbers) if numbers else None


def _companions(arguments: dict[str, Any], options: dict[str, Any]) -> list[Companion]:
    """What --with, --with-motion and --with-tier say: of the latter none, one for all, or one each."""
    from ..motions import MOTIONS, motions_named, read_motions
    from ..play.company import Companion, Place

    avatars = arguments["with_avatar"]
    each: dict[str, list[str | None]] = {}
    for name in ("with_motion", "with_tier"):
        given = arguments[name]
        if len(given) not in (0, 1, len(avatars)) or (given and not avatars):
            flag = name.replace("_", "-")
            raise WrongValue(
                f"--{flag} is given {len(given)} times and --with {len(avatars)}: give it once or for each"
            )
        each[name] = given * len(avatars) if len(given) == 1 else given or [None] * len(avatars)
    companions = []
    for (path, place), motion, tier in zip(avatars, each["with_motion"], each["with_tier"], strict=True):
        with options_spelled(as_motion_options):
            names = motions_named(motion or arguments["motion"] or MOTIONS.default)
            read = read_motions(names, **options)
        companions.append(Companion(path, read, Place(*(place or (0, 0, 0))), tier))
    return companions


if __name__ == "__main__":
    main()
