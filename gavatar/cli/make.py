"""`gavatar-make CLIP`: film, one command, a page that plays."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from gavatar_runtime.cli.settings import as_flags
from gavatar_runtime.errors import UserError, exit_cleanly, options_spelled, spelled

from ..optional import requires_extra

DESCRIPTION = "From a video of a person to a page that plays their avatar: prepare, train, export, open."
EPILOG = """examples
  gavatar-make clip.mp4                               writes clip/clip.html and opens it
  gavatar-make clip.mp4 -o anna --height 1.72
  gavatar-make clip.mp4 --minutes 3                   trains the best avatar that three minutes allow here
  gavatar-make clip.mp4 -o quick --preset demo stage1.steps=100
  gavatar-make captures/anna -o anna                  of a capture that gavatar-prepare wrote

A command that was interrupted goes on where it was when it is given again. The steps one by one, with all their
options: gavatar-prepare, gavatar-train, gavatar-export, gavatar-convert.
"""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "gavatar-make", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("clip", metavar="CLIP", type=Path, help="a video, a folder of frames, or a capture")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="gavatar-train settings")
    parser.add_argument("-o", "--out", metavar="DIR", type=Path, help="where to write (default: CLIP without suffix)")
    parser.add_argument("--preset", default="default", metavar="NAME", help="of gavatar-train (default: default)")
    parser.add_argument(
        "--minutes", type=float, metavar="M", help="that training may take (default: the steps of the preset)"
    )
    parser.add_argument("--height", type=float, metavar="M", help="the person's height in metres, if known")
    parser.add_argument("--fps", type=float, help="of the footage, where it does not say")
    parser.add_argument("--no-browser", action="store_true", help="do not open the page")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    return parser


@exit_cleanly
@requires_extra("train")
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_intermixed_args(argv)
    for setting in arguments.settings:
        if "=" not in setting:
            raise UserError(f"'{setting}' is not a setting: write KEY=VALUE, or -o DIR for the folder")
    from ..making import make
    from ..overrides import from_overrides

    footage = {name: getattr(arguments, name) for name in ("height", "fps") if getattr(arguments, name) is not None}
    settings = from_overrides(arguments.settings)
    if arguments.minutes is not None:
        settings["minutes"] = arguments.minutes
    flags = as_flags(vars(arguments))
    with options_spelled(flags):
        made = make(
            arguments.clip, arguments.out, preset=arguments.preset, settings=settings,
            say=lambda sentence: print(spelled(sentence, flags), flush=True), progress=not arguments.quiet, **footage,
        )  # fmt: skip
    print(made)
    if not arguments.no_browser:
        webbrowser.open(made.page.resolve().as_uri())
    return 0


if __name__ == "__main__":
    main()
