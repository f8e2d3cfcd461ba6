"""`gavatar-play`: an avatar bundle in motion, as a video, frames or a contact sheet. Loads no torch."""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

from ..errors import exit_cleanly
from .play_arguments import parser
from .settings import parse_settings


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
    from ..play.player import build_rasterizer, play
    from ..play.selection import choose_tier
    from ..play.staging import clip, open_avatar, staged
    from ..play.writers import open_writer
    from .play_report import peak_memory_mb, show_progress, table, timing_report

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
    for told in (*motion.notes, *([note] if note else [])):
        if not arguments.quiet:
            print(f"note: {told}", file=sys.stderr)
    if ignored and not arguments.quiet:
        print(f"note: the body has no {_listed(ignored)}; the motion's are ignored", file=sys.stderr)

    progress = show_progress if sys.stderr.isatty() and not arguments.quiet else None
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
        **timing_report(timings),
    }
    if arguments.budget_ms:
        report |= {"budget_ms": arguments.budget_ms, "levels": avatar.report()}  # fmt: skip
    if arguments.json:
        from ..formats.files import write_json

        write_json(arguments.json, report)
    if not arguments.quiet:
        print(table(report))
    return 0


def _default_output(avatar: str, motion: str) -> tuple[str, str]:
    """A name next to the bundle, and a note where it is a folder of frames for want of what writes videos."""
    from ..play.video import INSTALL, find_encoder

    path = Path(avatar).resolve()
    name = f"{path.parent / path.stem}_{motion}"
    if find_encoder() is not None:
        return f"{name}.mp4", ""
    return f"{name}/", f"frames go to {name}/: to write a video takes OpenCV ({INSTALL}) or a program ffmpeg"


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


if __name__ == "__main__":
    main()
