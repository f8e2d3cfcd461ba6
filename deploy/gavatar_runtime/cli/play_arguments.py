"""The arguments of `gavatar-play`. Imports neither numpy nor a network, so that --help comes at once."""

from __future__ import annotations

import argparse
import re

DESCRIPTION = "Play an avatar: pose it by a motion, splat it, write a video, a folder of frames or a contact sheet."
EPILOG = """examples
  gavatar-play anna.gavatar                                    a turn, as anna_turn.mp4 next to the bundle; frames in
                                                               anna_turn/ where neither OpenCV nor ffmpeg is installed
  gavatar-play anna.gavatar --motion wave --orbit --out wave.mp4
  gavatar-play anna.gavatar --motion dance.npz --frames 0:300 --size 1024 --out frames/
  gavatar-play anna.gavatar --motion wave --set motion.waves=3 --out sheet.png
  gavatar-play anna.gavatar --fps 30                           by the closest stored tier that plays at 30
  gavatar-play anna.gavatar --min-psnr 38                      by the fastest that is so close to the full model
  gavatar-play anna.gavatar --motion capture/body.npz --camera capture/cameras.json:cam0

Motion files: .bvh, and .npz, .npy, .pkl, .pth and .json of AMASS, the SMPL family and pose estimators; see
gavatar-motion. They are turned y-up; --set motion.up=z, y or -y says which way was up where that is told wrongly.
"""
DEFAULT_SIZE, MAX_SIZE = 512, 8192
DEFAULT_FPS = 30.0
AUTO = "auto"
COLORS = {"white": (1, 1, 1), "black": (0, 0, 0), "grey": (0.5, 0.5, 0.5), "gray": (0.5, 0.5, 0.5), "green": (0, 1, 0)}


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        "gavatar-play", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("avatar", metavar="NAME.gavatar", help="bundle that gavatar-export wrote, zipped or unpacked")
    p.add_argument("--motion", default="turn", metavar="NAME|FILE", help="turn, wave or a motion file (default: turn)")
    p.add_argument(
        "--out", metavar="PATH", help="X.mp4, X.png (contact sheet) or folder/ (default: a video next to the bundle)"
    )
    p.add_argument("--ground", action="store_true", help="let the avatar stand on the floor, y = 0")
    p.add_argument("--rest", choices=("auto", "offsets", "first-frame", "anatomy"),
                   help="of BVH: the pose that counts as standing at rest (default: auto)")  # fmt: skip
    time = p.add_argument_group("time")
    time.add_argument(
        "--fps", type=_positive, help="frames per second of the video, and, unless --tier says another, by the closest "
        f"stored tier that plays so fast (default: the motion's own, at most {DEFAULT_FPS:g}, by tier full)",
    )  # fmt: skip
    time.add_argument("--seconds", type=_positive, help="play for so long: a shorter motion repeats, a longer is cut")
    time.add_argument(
        "--frames", type=frame_slice, metavar="A:B", help="only frames A to B-1 at that rate, or A:B:STEP, or A"
    )
    view = p.add_argument_group("view")
    view.add_argument("--size", type=_pixels, metavar="PX", help=f"width and height (default: {DEFAULT_SIZE})")
    view.add_argument("--width", type=_pixels, metavar="PX")
    view.add_argument("--height", type=_pixels, metavar="PX")
    view.add_argument(
        "--camera", default="front", metavar="VIEW|FILE", help="front, left, back, right, degrees, or FILE.json[:NAME]"
    )
    view.add_argument(
        "--orbit", type=_positive, nargs="?", const=0.0, metavar="SECONDS",
        help="circle the person, once in SECONDS (default: once in the clip)",
    )  # fmt: skip
    view.add_argument(
        "--background", type=color_from, default="white", help="white, black, grey, green, #rrggbb or r,g,b"
    )
    work = p.add_argument_group("work")
    work.add_argument("--tier", metavar="NAME", help="how it is decoded, of those the bundle holds (default: full)")
    work.add_argument(
        "--min-psnr", type=_positive, metavar="DB", help="the fastest stored tier this close to the full model"
    )
    work.add_argument(
        "--target-fps", type=_positive, metavar="FPS",
        help="as --fps picks a tier, whatever the rate of the video; an error where none is so fast",
    )  # fmt: skip
    work.add_argument(
        "--budget-ms",
        type=_positive,
        metavar="MS",
        help="keep frames within MS: adapts the level of detail as it plays",
    )
    work.add_argument(
        "--uv",
        "--detail",
        type=_detail,
        metavar="R|auto",
        help="level of detail: side of the atlas, or auto: by the person's size on screen (default: all Gaussians)",
    )
    work.add_argument(
        "--seen-only", action="store_true", help="full and int8 decode only Gaussians that the camera can see"
    )
    work.add_argument("--reuse", type=_count, default=1, metavar="K", help="decode every K-th frame only (default: 1)")
    work.add_argument(
        "--rasterizer", default="auto", metavar="NAME", help="auto, or one of gavatar-list (default: auto)"
    )
    work.add_argument("--threads", type=_count, metavar="N", help="CPU threads (default: all cores)")
    work.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="motion.KEY=VALUE or rasterizer.KEY=VALUE"
    )
    work.add_argument("--json", metavar="FILE", help="write the timings there too")
    work.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return p


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def _detail(text: str) -> int | str:
    return AUTO if text == AUTO else _count(text)


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 1 up")
    return value


def _pixels(text: str) -> int:
    value = _count(text)
    if value > MAX_SIZE:
        raise argparse.ArgumentTypeError(f"{text} pixels are too many: at most {MAX_SIZE}")
    return value


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
    if len(numbers) == 1:
        return slice(numbers[0], numbers[0] + 1 or None)
    return slice(*numbers)


def color_from(text: str) -> tuple[float, ...]:
    """sRGB in [0, 1] of a name, `#rrggbb` or `r,g,b`. Raises ArgumentTypeError."""
    if text.lower() in COLORS:
        return COLORS[text.lower()]
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        return tuple(int(text[i : i + 2], 16) / 255 for i in (1, 3, 5))
    try:
        color = tuple(float(part) for part in text.split(","))
    except ValueError:
        color = ()
    if len(color) != 3 or not all(0 <= c <= 1 for c in color):
        raise argparse.ArgumentTypeError(f"'{text}': give {', '.join(COLORS)}, #rrggbb, or r,g,b between 0 and 1")
    return color
