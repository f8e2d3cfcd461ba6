"""`gavatar-export RUN -o NAME.gavatar`: the trained avatar as a verified ONNX bundle."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gavatar_runtime.errors import UserError, exit_cleanly

from ..optional import requires_extra

DESCRIPTION = "Export a trained run as an avatar bundle that plays without torch, verified against the PyTorch model."
EPILOG = """examples
  gavatar-export runs/anna                     writes runs/anna/anna.gavatar
  gavatar-export runs/anna -o anna.gavatar
  gavatar-export runs/anna --stage 1 -o anna_static.gavatar    without dynamics
  gavatar-export runs/anna --tiers auto        with the cheaper tiers that pay on this machine
  gavatar-export runs/anna --tiers blendshape,baked --uv 512

The bundle is written only if, on real poses of the capture, positions agree with PyTorch within 0.1 mm and colours
within 1/255. Play it with: gavatar-play anna.gavatar --motion wave
"""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "gavatar-export", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", metavar="RUN", help="run directory that gavatar-train wrote")
    parser.add_argument("-o", "--out", metavar="FILE", help="bundle to write (default: RUN/<capture>.gavatar)")
    parser.add_argument("--stage", type=int, choices=(1, 2), help="avatar of this stage (default: the last trained)")
    parser.add_argument("--capture", metavar="DIR", help="where the capture is now, if it has moved")
    parser.add_argument(
        "--uv",
        type=int,
        metavar="R",
        help="side of the atlas whose texels are the Gaussians (default: as trained)",
    )
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
    parser.add_argument("--poses", type=int, default=8, metavar="N", help="poses to verify on (default: 8)")
    return parser


@exit_cleanly
@requires_extra("train")
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    from ..config import register_configs
    from ..export.bundling import export, export_front
    from ..training.run import open_run

    if arguments.poses < 1:
        raise UserError("--poses must be at least 1: an export that is not verified is not written")
    register_configs()
    run = open_run(arguments.run, arguments.stage, arguments.capture)
    out = Path(arguments.out or Path(arguments.run) / f"{run.capture.name}.gavatar")
    if out.suffix != ".gavatar":
        raise UserError(f"{out}: a bundle's name ends in .gavatar")
    tiers = [name.strip() for name in (arguments.tiers or "").split(",") if name.strip()]
    options = {"uv": arguments.uv, "drop_unseen": arguments.drop_unseen, "progress": sys.stderr.isatty()}
    if tiers == ["auto"]:
        manifest = export_front(run, out, arguments.poses, **options)
    else:
        manifest = export(run, out, arguments.poses, tiers=tiers, **options)
    check = manifest.export_check
    print(
        f"{out}: {manifest.gaussians} Gaussians, {'dynamic' if manifest.dynamic else 'static'}, "
        f"opset {manifest.opset}, "
        f"{out.stat().st_size / 1e6:.1f} MB\n"
        f"verified on {check['poses']} poses: positions within {1000 * check['position_m']:.5f} mm, "
        f"colours within {255 * check['color']:.4f}/255 of PyTorch"
    )
    if arguments.drop_unseen:
        unseen = manifest.training["unseen"]
        print(
            f"unseen: {unseen['dropped']} Gaussians left out; {unseen['psnr']:.1f} dB against all of them on "
            f"{unseen['views']} views held out, worst {unseen['worst_psnr']:.1f}"
        )
    for tier in manifest.tiers:
        print(
            f"tier {tier['name']}: {tier['psnr_capture']:.1f} dB against full on poses of the capture (worst "
            f"{tier['worst_psnr_capture']:.1f}), {tier['psnr_mixed']:.1f} dB on mixed ones, {tier['frame_ms']:.1f} ms "
            f"a frame of {tier['size']} pixels here"
        )
    return 0
