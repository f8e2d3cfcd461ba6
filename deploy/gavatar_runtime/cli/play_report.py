"""What `gavatar-play` tells: the report as a table and as JSON, and how far it is."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

from ..play.performance import PlayReport
from ..play.player import WRITE, Timings
from ..progress import Progress


def as_json(report: PlayReport) -> dict[str, Any]:
    """Plain values, with the peak memory of this process."""
    values = {field.name: getattr(report, field.name) for field in dataclasses.fields(report)}
    del values["timings"]
    if report.budget_ms is None:
        del values["budget_ms"], values["levels"]
    return {**values, "peak_memory_mb": peak_memory_mb(), **timing_report(report.timings)}


def timing_report(timings: Timings) -> dict[str, Any]:
    """Median milliseconds by stage and of a frame; those of writing are not part of the frame's."""
    ms = {stage: 1e3 * seconds for stage, seconds in timings.medians().items()}
    write = ms.pop(WRITE)
    return {
        "stage_ms": ms,
        "frame_ms": 1e3 * timings.frame_seconds,
        "frames_per_second": timings.frames_per_second,
        "write_ms": write,
    }


def peak_memory_mb() -> float | None:
    """The most memory this process had resident so far, MB; None where the system does not tell. (What getrusage gives
    includes the process that started this one.)"""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return None
    found = re.search(r"VmHWM:\s*(\d+) kB", status)
    return int(found.group(1)) / 1000 if found else None


def table(report: PlayReport) -> str:
    """The report of a run as lines for people."""
    times = timing_report(report.timings)
    size = "" if report.width is None else f" of {report.width}x{report.height}"
    drawn_by = "" if report.rasterizer is None else f", {report.rasterizer}"
    frames = f"{report.frames} frame{'' if report.frames == 1 else 's'}"
    lines = [
        f"{report.output}: {frames}{size}, {report.gaussians} Gaussians, tier {report.tier}{drawn_by}",
        f"{'stage':<10}{'ms a frame':>12}   (median after warm-up)",
        *(f"{stage:<10}{ms:>12.2f}" for stage, ms in times["stage_ms"].items()),
        f"{'frame':<10}{times['frame_ms']:>12.2f}   = {times['frames_per_second']:.1f} frames per second"
        + ("; a frame is decoded while the one before is drawn" if report.rasterizer else ""),
        f"{'write':<10}{times['write_ms']:>12.2f}   not counted above",
        f"ready to play after {report.ready_seconds:.2f} s",
    ]
    for level in report.levels:
        detail = f"{level['gaussians'] or 'all'} Gaussians"
        every = "" if level["reuse"] == 1 else f", decoded every {level['reuse']} frames"
        lines.append(f"budget {report.budget_ms:g} ms: {level['frames']} frames with {detail}{every}")
    return "\n".join(lines)


class FrameBar:
    """Shows how many frames are played, as `perform` tells it."""

    def __init__(self) -> None:
        self._bar: Progress | None = None

    def __call__(self, done: int, total: int) -> None:
        self._bar = self._bar or Progress("play", total, "frame")
        self._bar.advance(done - self._bar.done)
        if done == total:
            self._bar.close()
