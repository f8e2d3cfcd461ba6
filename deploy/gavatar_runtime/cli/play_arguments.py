"""The arguments of `gavatar-play`. Imports neither numpy nor a network, so that --help comes at once."""

from __future__ import annotations

import argparse
import re

from ..play.defaults import AUTO, BLEND, DEFAULT_FPS, DEFAULT_SIZE

DESCRIPTION = "Play an avatar: pose it by a motion, splat it, write a video, frames, a contact sheet or its Gaussians."
EPILOG = """examples
  gavatar-play anna.gavatar                                    a turn, as anna_turn.mp4 next to the bundle; frames in
                                                               anna_turn/ where neither OpenCV nor ffmpeg is installed
  gavatar-play anna.gavatar --motion wave --orbit --out wave.mp4
  gavatar-play anna.gavatar --motion walk,wave,idle --set motion.travel=true --blend 0.5
  gavatar-play anna.gavatar --motion wave --with ben.gavatar@1,0.2:-30 --with-motion dance
  gavatar-play anna.gavatar --motion dance.npz --frames 0:300 --size 1024 --out frames/
  gavatar-play anna.gavatar --motion wave --set motion.waves=3 --out sheet.png
  gavatar-play anna.gavatar --frames 30 --out anna.ply         the Gaussians of a frame, for programs that show splats
  gavatar-play anna.gavatar --motion wave --out wave/%06d.ply  and those of each frame
  gavatar-play anna.gavatar --fps 30                           by the closest stored tier that plays at 30
  gavatar-play anna.gavatar --min-psnr 38                      by the fastest that is so close to the full model
  gavatar-play anna.gavatar --motion capture/body.npz --camera capture/cameras.json:cam0

Motion files: .bvh, and .npz, .npy, .pkl, .pth and .json of AMASS, the SMPL family and pose estimators; see
gavatar-motion. They are turned y-up; --set motion.up=z, y or -y says which way was up where that is told wrongly.
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        "gavatar-play", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("avatar", metavar="NAME.gavatar", help="bundle that gavatar-export wrote, zipped or unpacked")
    p.add_argument(
        "--motion",
        metavar="NAME|FILE,...",
        help="turn, wave, idle, walk, run, jump, dance, stretch or a motion file; several, with commas between, play "
        "one after another (default: turn)",
    )
    p.add_argument("--blend", type=float, default=BLEND, metavar="SECONDS",
                   help=f"from each motion to the next (default: {BLEND:g})")  # fmt: skip
    p.add_argument(
        "--out",
        metavar="PATH",
        help="X.mp4, X.png (contact sheet), folder/, X.ply, folder/%%06d.ply, or what else gavatar-list output names "
        "(default: a video next to the bundle)",
    )
    p.add_argument("--output", metavar="NAME", help="kind of output, where the suffix of PATH alone does not tell")
    p.add_argument("--ground", action="store_true", help="let the avatar stand on the floor, y = 0")
    p.add_argument("--rest", choices=("auto", "offsets", "first-frame", "anatomy"),
                   help="of BVH: the pose that counts as standing at rest (default: auto)")  # fmt: skip
    _add_company(p.add_argument_group("several avatars"))
    _add_time(p.add_argument_group("time"))
    _add_view(p.add_argument_group("view"))
    _add_work(p.add_argument_group("work"))
    return p


def _add_company(company: argparse._ArgumentGroup) -> None:
    company.add_argument(
        "--with", dest="with_avatar", action="append", default=[], type=placed_avatar,
        metavar="NAME.gavatar[@X,Z[:DEGREES]]", help="another avatar in the picture: metres to the left and ahead of "
        "the origin, turned to its left; may be given again",
    )  # fmt: skip
    company.add_argument("--with-motion", action="append", default=[], metavar="NAME|FILE,...",
                         help="what it does, one for all or one for each --with (default: as --motion)")  # fmt: skip
    company.add_argument("--with-tier", action="append", default=[], metavar="NAME",
                         help="how it is decoded, one for all or one for each --with (default: as --tier)")  # fmt: skip
    company.add_argument("--at", type=place, metavar="X,Z[:DEGREES]", help="where the first stands (default: 0,0:0)")


def placed_avatar(text: str) -> tuple[str, tuple[float, float, float] | None]:
    """Of `NAME.gavatar@X,Z:DEGREES`, with or without a place. An @ with no number behind it is part of the name.
    Raises ArgumentTypeError for a place that is none."""
    path, at, tail = text.rpartition("@")
    if not at or not re.match(r"[-+.\d]", tail):
        return text, None
    return path, place(tail)


def place(text: str) -> tuple[float, float, float]:
    """X, Z and degrees of `X,Z:DEGREES` or `X,Z`. Raises ArgumentTypeError."""
    position, _, heading = text.partition(":")
    try:
        x, z = map(float, position.split(","))
        return x, z, float(heading) if heading else 0.0
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not X,Z or X,Z:DEGREES, in metres") from None


def _add_time(time: argparse._ArgumentGroup) -> None:
    time.add_argument(
        "--fps", type=float, help="frames per second of the video, and, unless --tier says another, by the closest "
        f"stored tier that plays so fast (default: the motion's own, at most {DEFAULT_FPS:g}, by tier full)",
    )  # fmt: skip
    time.add_argument("--seconds", type=float, help="play for so long: a shorter motion repeats, a longer is cut")
    time.add_argument(
        "--frames", type=frame_slice, metavar="A:B", help="only frames A to B-1 at that rate, or A:B:STEP, or A"
    )


def _add_view(view: argparse._ArgumentGroup) -> None:
    view.add_argument("--size", type=int, metavar="PX", help=f"width and height (default: {DEFAULT_SIZE})")
    view.add_argument("--width", type=int, metavar="PX")
    view.add_argument("--height", type=int, metavar="PX")
    view.add_argument(
        "--camera", default="front", metavar="VIEW|FILE", help="front, left, back, right, degrees, or FILE.json[:NAME]"
    )
    view.add_argument(
        "--orbit", type=float, nargs="?", const=True, metavar="SECONDS",
        help="circle the person, once in SECONDS (default: once in the clip)",
    )  # fmt: skip
    view.add_argument(
        "--background", default="white", metavar="COLOR", help="white, black, grey, green, #rrggbb or r,g,b"
    )


def _add_work(work: argparse._ArgumentGroup) -> None:
    work.add_argument("--tier", metavar="NAME", help="how it is decoded, of those the bundle holds (default: full)")
    work.add_argument(
        "--min-psnr", type=float, metavar="DB", help="the fastest stored tier this close to the full model"
    )
    work.add_argument(
        "--target-fps", type=float, metavar="FPS",
        help="as --fps picks a tier, whatever the rate of the video; an error where none is so fast",
    )  # fmt: skip
    work.add_argument(
        "--budget-ms",
        type=float,
        metavar="MS",
        help="keep frames within MS: adapts the level of detail as it plays",
    )
    work.add_argument(
        "--gaussians",
        type=detail,
        metavar="N|auto",
        help="level of detail: at most N Gaussians, or auto: as many as the person's pixels need (default: all)",
    )
    work.add_argument("--uv", "--detail", type=detail, metavar="R", help="the former --gaussians, as an atlas's side")
    work.add_argument(
        "--seen-only", action="store_true", help="full and int8 decode only Gaussians that the camera can see"
    )
    work.add_argument("--reuse", type=int, default=1, metavar="K", help="decode every K-th frame only (default: 1)")
    work.add_argument(
        "--rasterizer", default="auto", metavar="NAME", help="auto, or one of gavatar-list (default: auto)"
    )
    work.add_argument("--threads", type=int, metavar="N", help="CPU threads (default: all cores)")
    work.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="motion., rasterizer. or output.KEY=VALUE"
    )
    work.add_argument("--json", metavar="FILE", help="write the timings there too")
    work.add_argument("--quiet", action="store_true", help="print nothing but errors")


def detail(text: str) -> int | str:
    return AUTO if text == AUTO else int(text)


def frame_slice(text: str) -> slice:
    """Of `A:B`, `A:B:STEP` or `A`, counted as Python counts. Raises ArgumentTypeError."""
    parts = text.split(":")
    try:
        numbers = [int(part) if part else None for part in parts]
    except ValueError:
        numbers = []
    step = numbers[2] if len(numbers) == 3 else None
    if not 1 <= len(numbers) <= 3 or numbers == [None] or (step is not None and step < 1):
        raise argparse.ArgumentTypeError(f"'{text}' is not A:B, A:B:STEP or A, in whole numbers")
    first = numbers[0]
    if len(numbers) == 1 and first is not None:
        return slice(first, first + 1 or None)
    return slice(*numbers)
