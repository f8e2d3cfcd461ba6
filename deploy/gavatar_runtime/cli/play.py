"""`gavatar-play`: an avatar bundle in motion, as a video, frames or a contact sheet. Loads no torch."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from ..errors import UserError, did_you_mean, exit_cleanly

if TYPE_CHECKING:  # what these import must not slow down --help
    from ..avatar import Avatar
    from ..bundle import Bundle
    from ..camera import Camera
    from ..motion import Motion
    from ..player import Timings

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

Motion files: .npz (AMASS, SMPL, SMPL-H, SMPL-X), .bvh, .pkl (AIST++), .pth (GaussianAvatar); see gavatar-motion. They
are turned y-up; --set motion.up=z, y or -y says which way was up where that is told wrongly.
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
    p.add_argument("--rest", choices=("offsets", "first-frame"),
                   help="of BVH: the pose that counts as standing at rest (default: offsets)")  # fmt: skip
    time = p.add_argument_group("time")
    time.add_argument(
        "--fps", type=_positive, help="frames per second of the video, and, unless --tier says another, by the closest "
        f"stored tier that plays so fast (default: the motion's own, at most {DEFAULT_FPS:g}, by tier full)",
    )  # fmt: skip
    time.add_argument("--seconds", type=_positive, help="play for so long: a shorter motion repeats, a longer is cut")
    time.add_argument(
        "--frames", type=_slice, metavar="A:B", help="only frames A to B-1 at that rate, or A:B:STEP, or A"
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
    view.add_argument("--background", type=_color, default="white", help="white, black, grey, green, #rrggbb or r,g,b")
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


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = parser().parse_args(argv)
    start = perf_counter()
    options = parse_settings(arguments.set)
    if arguments.rest:
        options["motion"]["rest"] = arguments.rest

    from .. import native_library
    from ..bundle import read_bundle
    from ..motions import read_motion
    from ..player import build_rasterizer, play
    from ..selection import choose_tier
    from ..writers import open_writer

    motion = read_motion(arguments.motion, **options["motion"])
    motion = clip(motion, arguments.fps, arguments.seconds, arguments.frames)
    bundle = read_bundle(arguments.avatar)
    tier = choose_tier(bundle, arguments)
    avatar = open_avatar(bundle, tier, motion, arguments)
    motion, ignored, cameras = staged(avatar, motion, arguments)
    rasterizer = build_rasterizer(
        arguments.rasterizer, options["rasterizer"], threads=arguments.threads, trained=bundle.manifest.rasterizer
    )
    out, note = (arguments.out, "") if arguments.out else _default_output(arguments.avatar, motion.name)
    size = {"width": cameras[0].width, "height": cameras[0].height}
    writer = open_writer(out, **size, fps=motion.fps, background=arguments.background)
    ready = perf_counter() - start
    if arguments.rasterizer == "auto" and not native_library.available()[0] and not arguments.quiet:
        print(
            f"note: rasterizer numpy, many times slower than native: {native_library.available()[1]}", file=sys.stderr
        )
    if note and not arguments.quiet:
        print(f"note: {note}", file=sys.stderr)
    if ignored and not arguments.quiet:
        print(f"note: the body has no {_listed(ignored)}; the motion's are ignored", file=sys.stderr)

    progress = _progress if sys.stderr.isatty() and not arguments.quiet else None
    timings = play(avatar, motion, cameras, rasterizer, writer, background=arguments.background, progress=progress)
    report = {
        "avatar": avatar.name,
        "motion": motion.name,
        "output": str(out),
        "frames": len(timings),
        **size,
        "fps": motion.fps,
        "gaussians": len(avatar),
        "tier": tier,
        "uv": avatar.uv,
        "rasterizer": type(rasterizer).__name__,
        "threads": arguments.threads,
        "ignored_joints": list(ignored),
        "ready_seconds": ready,
        "peak_memory_mb": peak_memory_mb(),
        **_timing_report(timings),
    }
    if arguments.budget_ms:
        report |= {"budget_ms": arguments.budget_ms, "levels": avatar.report()}  # fmt: skip
    if arguments.json:
        from ..files import write_json

        write_json(arguments.json, report)
    if not arguments.quiet:
        print(_table(report))
    return 0


def open_avatar(bundle: Bundle, tier: str, motion: Motion, arguments: argparse.Namespace) -> Avatar:
    """The avatar at the level of detail that is asked for, or one that adapts it."""
    from ..avatar import Avatar

    if arguments.budget_ms:
        from ..adaptive import AdaptiveAvatar

        if arguments.uv or arguments.reuse > 1 or arguments.seen_only:
            raise UserError(
                "--budget-ms chooses the level of detail and the reuse: leave --uv, --reuse and --seen-only out"
            )
        return AdaptiveAvatar(bundle, arguments.budget_ms / 1000, tier=tier, threads=arguments.threads)
    uv = _uv_on_screen(bundle, motion, arguments) if arguments.uv == AUTO else arguments.uv
    how = {"tier": tier, "reuse": arguments.reuse, "seen_only": arguments.seen_only, "threads": arguments.threads}
    avatar = Avatar(bundle, uv=uv, **how)
    if arguments.seen_only and not avatar.seen_only:
        raise UserError(f"--seen-only: {_why_not_seen_only(avatar, arguments.reuse)}")
    return avatar


def _uv_on_screen(bundle: Bundle, motion: Motion, arguments: argparse.Namespace) -> int | None:
    """The level of detail that the person's largest size in the images is worth."""
    from ..avatar import Avatar
    from ..detail import WORTH, uv_for_size
    from ..framing import size_on_screen

    body = Avatar(bundle, tier=None)
    motion, _, cameras = staged(body, motion, arguments)
    uv = uv_for_size(body.surface, size_on_screen(body, motion, cameras))
    return uv if uv < WORTH * body.surface.resolution else None


def staged(
    avatar: Avatar, motion: Motion, arguments: argparse.Namespace
) -> tuple[Motion, tuple[str, ...], list[Camera]]:
    """The motion fitted to the avatar, on the floor if asked, what of it the body lacks, and one camera a frame."""
    motion, ignored = avatar.fit(motion)
    if arguments.ground:
        from ..grounding import grounded

        motion, _ = grounded(avatar, motion)
    return motion, ignored, choose_cameras(arguments, avatar, motion)


def _why_not_seen_only(avatar: Avatar, reuse: int) -> str:
    from ..tiers import player_tiers

    if reuse > 1:
        return "decodes that are reused are of all Gaussians: leave --reuse out"
    if player_tiers()[avatar.tier].factory.picks and avatar.dynamic:
        return f"{avatar.bundle.path} was written before that was possible: export it again"
    return f"tier {avatar.tier} has nothing to leave out: it is for --tier full and int8 of an avatar with dynamics"


def peak_memory_mb() -> float | None:
    """The most memory this process had resident so far, MB; None where the system does not tell. (What getrusage gives
    includes the process that started this one.)"""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return None
    found = re.search(r"VmHWM:\s*(\d+) kB", status)
    return int(found.group(1)) / 1000 if found else None


def clip(motion: Motion, fps: float | None, seconds: float | None, frames: slice | None) -> Motion:
    """The part of a motion that is played: resampled, then repeated or cut to `seconds`, then `frames` of that.

    fps: None keeps the motion's own up to 30. Raises UserError when no frame is left.
    """
    import numpy as np

    fps = fps or min(motion.fps, DEFAULT_FPS)
    motion = motion.resampled(fps)
    index = np.arange(len(motion))
    if seconds is not None:
        index = np.arange(max(1, round(seconds * fps))) % len(motion)
    if frames is not None:
        count, index = len(index), index[frames]
        if not len(index):
            raise UserError(
                f"--frames leaves no frame: motion '{motion.name}' has {count} at {fps:g} frames per second"
            )
    return motion.taken(index)


def choose_cameras(arguments: argparse.Namespace, avatar: Avatar, motion: Motion) -> list[Camera]:
    """One camera a frame, from --camera, --orbit and the size options."""
    import numpy as np

    from ..camera_file import read_camera
    from ..framing import DIRECTIONS, body_points, fitted_to, frame_motion, orbit

    asked = arguments.size or arguments.width or arguments.height
    width = arguments.width or arguments.size or arguments.height or DEFAULT_SIZE
    height = arguments.height or arguments.size or arguments.width or DEFAULT_SIZE
    if ".json" in arguments.camera.lower():
        camera = read_camera(arguments.camera)
        if asked:
            camera = fitted_to(camera, width, height)
    else:
        azimuth = _azimuth(arguments.camera, DIRECTIONS)
        camera = frame_motion(avatar, motion, width, height, azimuth=azimuth, orbit=arguments.orbit is not None)
    if arguments.orbit is None:
        return [camera] * len(motion)
    points = body_points(avatar, motion)
    period = arguments.orbit * motion.fps or len(motion)
    return orbit(camera, (points.min(0) + points.max(0)) / 2, np.arange(len(motion)) / period)


def parse_settings(settings: list[str]) -> dict[str, dict[str, Any]]:
    """`motion.KEY=VALUE` and `rasterizer.KEY=VALUE` by group; numbers and true/false become what they look like."""
    options: dict[str, dict[str, Any]] = {"motion": {}, "rasterizer": {}}
    for setting in settings:
        match = re.fullmatch(r"(\w+)\.(\w+)=(.*)", setting)
        if match is None:
            raise UserError(f"--set {setting}: expected motion.KEY=VALUE or rasterizer.KEY=VALUE")
        group, key, text = match.groups()
        if group not in options:
            raise UserError(f"--set {setting}: unknown group '{group}': {did_you_mean(group, options)}")
        options[group][key] = _value(text)
    return options


def _value(text: str) -> Any:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def _azimuth(text: str, directions: dict[str, float]) -> float:
    if text in directions:
        return directions[text]
    value = _value(text)
    if isinstance(value, (int, float)) and abs(value) <= 1e6:
        return float(value)
    raise UserError(f"unknown camera '{text}': give degrees, FILE.json[:NAME], or {did_you_mean(text, directions)}")


def _default_output(avatar: str, motion: str) -> tuple[str, str]:
    """A name next to the bundle, and a note where it is a folder of frames for want of what writes videos."""
    from ..video import INSTALL, find_encoder

    path = Path(avatar).resolve()
    name = f"{path.parent / path.stem}_{motion}"
    if find_encoder() is not None:
        return f"{name}.mp4", ""
    return f"{name}/", f"frames go to {name}/: to write a video takes OpenCV ({INSTALL}) or a program ffmpeg"


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _timing_report(timings: Timings) -> dict[str, Any]:
    from ..player import WRITE

    ms = {stage: 1e3 * seconds for stage, seconds in timings.medians().items()}
    write = ms.pop(WRITE)
    return {
        "stage_ms": ms,
        "frame_ms": 1e3 * timings.frame_seconds,
        "frames_per_second": timings.frames_per_second,
        "write_ms": write,
    }


def _table(report: dict[str, Any]) -> str:
    lines = [
        f"{report['output']}: {report['frames']} frames of {report['width']}x{report['height']}, "
        f"{report['gaussians']} Gaussians, tier {report['tier']}, {report['rasterizer']}",
        f"{'stage':<10}{'ms a frame':>12}   (median after warm-up)",
        *(f"{stage:<10}{ms:>12.2f}" for stage, ms in report["stage_ms"].items()),
        f"{'frame':<10}{report['frame_ms']:>12.2f}   = {report['frames_per_second']:.1f} frames per second; a frame is "
        "decoded while the one before is drawn",
        f"{'write':<10}{report['write_ms']:>12.2f}   not counted above",
        f"ready to play after {report['ready_seconds']:.2f} s",
    ]
    for level in report.get("levels", ()):
        detail = "all Gaussians" if level["uv"] is None else f"uv {level['uv']}"
        every = "" if level["reuse"] == 1 else f", decoded every {level['reuse']} frames"
        lines.append(f"budget {report['budget_ms']:g} ms: {level['frames']} frames with {detail}{every}")
    return "\n".join(lines)


def _progress(done: int, total: int) -> None:
    width = 30
    filled = width * done // total
    end = "\n" if done == total else ""
    print(f"\r[{'#' * filled}{'.' * (width - filled)}] {done}/{total}", end=end, file=sys.stderr, flush=True)


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


def _slice(text: str) -> slice:
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


def _color(text: str) -> tuple[float, ...]:
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


if __name__ == "__main__":
    main()
