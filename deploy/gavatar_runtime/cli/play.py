"""`gavatar-play`: an avatar bundle in motion, into a file. Loads no torch."""

from __future__ import annotations

import dataclasses
import sys
from time import perf_counter

from ..errors import exit_cleanly, options_spelled, spelled
from .play_arguments import parser
from .settings import as_flags, as_motion_options, parse_settings

OURS = ("avatar", "motion", "out", "rest", "set", "json", "quiet")  # the other arguments are keywords of `perform`


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


if __name__ == "__main__":
    main()
