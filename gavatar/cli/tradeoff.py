"""`gavatar-tradeoff AVATAR`: what each way of playing an avatar costs and gains on this machine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gavatar_runtime.cli.settings import as_flags
from gavatar_runtime.errors import UserError, exit_cleanly, options_spelled

from ..optional import requires_extra

DESCRIPTION = (
    "Measure speed against accuracy of an avatar's tiers, levels of detail and temporal reuse on this machine."
)
EPILOG = """examples
  gavatar-tradeoff anna.gavatar
  gavatar-tradeoff anna.gavatar --capture my_capture --json rows.json --figure front.png
  gavatar-tradeoff anna.gavatar --motion dance.npz --size 1024

Frame times are medians after a warm-up over three rounds in which the choices take turns; writing the video is not
part of them. PSNR is of whole frames on white. GFLOP/s and GB/s are of one matrix product and one copy, before and
after, by which tables of two days can be compared.
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        "gavatar-tradeoff", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("avatar", metavar="NAME.gavatar")
    p.add_argument("--capture", metavar="DIR", help="hold the choices against this capture's held-out frames as well")
    p.add_argument("--motion", metavar="NAME|FILE", help="what is played (default: the capture's motion, else wave)")
    p.add_argument("--size", type=int, default=512, metavar="PX", help="side of the images (default: 512)")
    p.add_argument("--frames", type=int, default=200, metavar="N", help="frames timed (default: 200)")
    p.add_argument("--tiers", metavar="NAME,NAME", help="only these tiers, without levels of detail (default: all)")
    p.add_argument("--threads", type=int, metavar="N", help="CPU threads (default: all cores)")
    p.add_argument("--no-perceptual", action="store_true", help="leave the perceptual distance out")
    p.add_argument("--no-process", action="store_true", help="leave memory and first-frame time out")
    p.add_argument("--json", metavar="FILE", help="write the rows there")
    p.add_argument("--figure", metavar="FILE", help="write the Pareto figure there (.png, .jpg, .svg)")
    return p


@exit_cleanly
@requires_extra("train")
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    a = parser().parse_args(argv)

    import numpy as np

    from gavatar_runtime.avatar.playing import Avatar
    from gavatar_runtime.bundle import read_bundle
    from gavatar_runtime.motions import MOTIONS, read_motion

    from ..capture.opening import open_capture
    from ..images.metrics import perceptual_metric
    from ..measure.choices import Choice
    from ..measure.ladder import run_ladder
    from ..measure.ladder_report import figure, table
    from ..measure.timing import machine, yardstick
    from ..registry import load_plugins
    from ..storage import write_json

    if a.size < 16 or a.frames < 8:
        raise UserError("--size must be at least 16 and --frames at least 8")
    load_plugins()
    path = Path(a.avatar)
    bundle = read_bundle(path)
    capture = open_capture(a.capture) if a.capture else None
    if a.motion:
        with options_spelled(lambda name, value: f"gavatar-motion convert --set {name}={value or 'VALUE'}"):
            motion = read_motion(a.motion)
    else:
        motion = (capture.truth or capture.motion) if capture else read_motion(MOTIONS.having(varied=True)[0])
    motion = Avatar(bundle, tier=None).fit(motion)[0]
    there_and_back = np.r_[: len(motion), len(motion) - 2 : 0 : -1] if len(motion) > 2 else np.arange(len(motion))
    index = np.resize(there_and_back, a.frames)
    motion = motion.taken(index)
    choices = [Choice(tier.strip()) for tier in a.tiers.split(",")] if a.tiers else None
    perceptual, name = (None, None) if a.no_perceptual else perceptual_metric()
    before = yardstick()
    with options_spelled(as_flags(vars(a))):
        rows = run_ladder(
            path, motion, a.size, a.size, capture=capture, choices=choices, perceptual=perceptual,
            processes=not a.no_process, threads=a.threads, say=lambda text: print(text, file=sys.stderr),
        )  # fmt: skip
    print(table(rows, f"{machine()} ({before} before, {yardstick()} after)", name))
    if a.json:
        write_json(a.json, [row.as_json() for row in rows])
    if a.figure:
        figure(rows, a.figure, f"{bundle.manifest.name}, {bundle.manifest.gaussians:,} Gaussians, {a.size} x {a.size}")
    return 0
