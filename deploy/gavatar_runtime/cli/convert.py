"""`gavatar-convert NAME.gavatar anna.html`: an avatar for other programs. Loads no torch."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ..errors import exit_cleanly, options_spelled, spelled
from .play_arguments import detail
from .settings import as_flags, parse_options

DESCRIPTION = (
    "Turn an avatar with motions into a file that plays elsewhere: a web page, a folder for a web server, a glTF file."
)
EPILOG = """examples
  gavatar-convert anna.gavatar anna.html                           one page, offline, with the motions turn and wave
  gavatar-convert anna.gavatar anna.html --motions wave,dance.npz
  gavatar-convert anna.gavatar site/ --gaussians 50000             page, gavatar.js and avatar.bin for a web server
  gavatar-convert anna.gavatar anna.glb --motions wave,turn        glTF: splats with a skin and an animation a motion

Which formats there are: gavatar-list conversion. Single frames and videos: gavatar-play.
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        "gavatar-convert", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("avatar", metavar="NAME.gavatar", help="bundle that gavatar-export wrote, zipped or unpacked")
    p.add_argument("out", metavar="PATH", help="X.html, X.glb, folder/, or what else gavatar-list conversion names")
    p.add_argument(
        "--motions", metavar="NAME,FILE", default=None, help="built-in motions and files, the first plays at the start "
        "(default: turn,wave)",
    )  # fmt: skip
    p.add_argument(
        "--gaussians", type=detail, metavar="N|auto", help="at most N Gaussians, or auto: as many as the footage's "
        "pixels were worth (default: all)",
    )  # fmt: skip
    p.add_argument("--tier", metavar="NAME", help="how the look is taken (default: the best that the format can play)")
    p.add_argument("--conversion", metavar="NAME", help="kind of file, where the suffix of PATH alone does not tell")
    p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="an option of the conversion")
    p.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return p


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    from ..conversions import convert, default_motions
    from ..motions import motions_named

    flags = as_flags(vars(arguments))
    motions = default_motions() if arguments.motions is None else motions_named(arguments.motions)
    with options_spelled(flags):
        notes = convert(
            arguments.avatar, arguments.out, motions=motions, tier=arguments.tier, gaussians=arguments.gaussians,
            name=arguments.conversion, options=parse_options(arguments.set),
        )  # fmt: skip
    if not arguments.quiet:
        for note in notes:
            print(f"note: {spelled(note, flags)}", file=sys.stderr)
        print(f"{arguments.out}: {size_of(Path(arguments.out)) / 1e6:.1f} MB, motions {', '.join(map(str, motions))}")
    return 0


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    return sum(f.stat().st_size for f in path.rglob("*") if f.is_file()) if path.is_dir() else path.stat().st_size


if __name__ == "__main__":
    main()
