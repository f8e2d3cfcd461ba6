"""`gavatar-export RUN -o NAME.gavatar`: the trained avatar as a verified ONNX bundle."""

from __future__ import annotations

import argparse

from gavatar_runtime.cli.play_arguments import detail
from gavatar_runtime.cli.settings import as_flags
from gavatar_runtime.errors import exit_cleanly, options_spelled

from ..optional import requires_extra

DESCRIPTION = "Export a trained run as an avatar bundle that plays without torch, verified against the PyTorch model."
EPILOG = """examples
  gavatar-export runs/anna                     writes runs/anna/anna.gavatar
  gavatar-export runs/anna -o anna.gavatar
  gavatar-export runs/anna -o anna.html        one web page that plays offline (gavatar-list conversion)
  gavatar-export runs/anna -o anna.html --motions wave,dance.npz
  gavatar-export runs/anna --stage 1 -o anna_static.gavatar    without dynamics
  gavatar-export runs/anna --tiers auto        with the cheaper tiers that pay on this machine
  gavatar-export runs/anna --tiers blendshape,baked --gaussians 100000

The bundle is written only if, on real poses of the capture, positions agree with PyTorch within 0.1 mm and colours
within 1/255. Play it with: gavatar-play anna.gavatar --motion wave
"""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "gavatar-export", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", metavar="RUN", help="run directory that gavatar-train wrote")
    parser.add_argument(
        "-o", "--out", metavar="FILE", help="bundle, or web page, to write (default: RUN/<capture>.gavatar)"
    )
    parser.add_argument("--stage", type=int, choices=(1, 2), help="avatar of this stage (default: the last trained)")
    parser.add_argument("--capture", metavar="DIR", help="where the capture is now, if it has moved")
    parser.add_argument(
        "--gaussians",
        type=detail,
        metavar="N|auto",
        help="how many Gaussians, or auto: as many as the footage's pixels are worth (default: as trained)",
    )
    parser.add_argument("--uv", type=int, metavar="R", help="the former --gaussians, as an atlas's side")
    parser.add_argument(
        "--tiers",
        metavar="NAME,NAME",
        help="cheaper ways to decode: baked, blendshape, coarse, int8, or auto",
    )
    parser.add_argument(
        "--drop-unseen",
        action="store_true",
        help="leave out Gaussians that no training view sees nor any neighbour within 2 cm; says what that changed",
    )
    parser.add_argument(
        "--motions",
        metavar="NAME,FILE",
        help="of a web page and what else is no bundle: built-in motions and files, the first plays at the start",
    )
    parser.add_argument("--poses", type=int, default=8, metavar="N", help="poses to verify on (default: 8)")
    return parser


@exit_cleanly
@requires_extra("train")
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    from gavatar_runtime.motions import motions_named

    from ..face import open_run

    run = open_run(arguments.run, arguments.stage, arguments.capture)
    with options_spelled(as_flags(vars(arguments))):
        print(run.export(
            arguments.out, tiers=arguments.tiers or "", gaussians=arguments.gaussians, uv=arguments.uv,
            drop_unseen=arguments.drop_unseen,
            poses=arguments.poses, progress=True,
            motions=None if arguments.motions is None else motions_named(arguments.motions),
        ))  # fmt: skip
    return 0


if __name__ == "__main__":
    main()
