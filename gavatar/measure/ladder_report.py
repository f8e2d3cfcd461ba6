"""The measured ladder as a table and as a figure of its Pareto front."""

from __future__ import annotations

from pathlib import Path

from gavatar_runtime.cpus import usable_cpus

from ..storage import atomic
from ..text_table import format_table
from .ladder import Row

HEADER = [
    "choice", "Gaussians", "frame ms", "10-90 %", "fps", "vs full", "worst", "footage", "worst", "perceptual",
    "memory MB", "first s", "bundle MB", "",
]  # fmt: skip


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _cells(row: Row) -> list[str]:
    """The row of the table, as HEADER names its cells."""
    low, high = row.speed.spread_ms
    footage, process = row.footage, row.process
    return [
        row.choice.label,
        str(row.gaussians),
        _text(row.speed.median_ms, 2),
        f"{low:.1f}-{high:.1f}",
        _text(row.speed.fps, 1),
        _text(row.full.psnr, 2),
        _text(row.full.worst_psnr, 2),
        _text(None if footage is None else footage.psnr, 2),
        _text(None if footage is None else footage.worst_psnr, 2),
        _text(row.full.perceptual, 4),
        _text(None if process is None else process.memory_mb, 0),
        _text(None if process is None else process.first_frame_s, 2),
        _text(row.bundle_mb, 1),
        "dominated" if row.dominated else "",
    ]


def table(rows: list[Row], machine: str, perceptual: str | None) -> str:
    """One line a choice, with what a reader must know to use the numbers."""
    lines = [_cells(row) for row in rows]
    notes = [
        f"{rows[0].width} x {rows[0].height} pixels, {usable_cpus()} cores, {machine}; frame times are medians after "
        "a warm-up, writing excluded",
        "vs full, footage, worst: PSNR of whole frames on white, dB; dominated: another choice is faster and closer",
    ]
    if perceptual:
        notes.append(f"perceptual: distance from the full model, {perceptual} (not LPIPS)")
    return format_table(HEADER, lines) + "\n\n" + "\n".join(notes)


def figure(rows: list[Row], path: str | Path, title: str) -> None:
    """Frames per second against PSNR from the full model; the front as a line, dominated choices hollow. The full
    model itself is drawn at the top edge."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    chart, axis = pyplot.subplots(figsize=(8, 5))
    top = max((row.full.psnr for row in rows if row.full.psnr < 99), default=40) + 4
    place = {id(row): (row.speed.fps, min(row.full.psnr, top)) for row in rows}
    front = sorted(place[id(row)] for row in rows if not row.dominated)
    axis.plot(*zip(*front, strict=True), color="0.7", zorder=1)
    colors = {tier: f"C{i}" for i, tier in enumerate(dict.fromkeys(row.choice.tier for row in rows))}
    for row in rows:
        x, y = place[id(row)]
        color = colors[row.choice.tier]
        axis.scatter([x], [y], s=36, facecolors="none" if row.dominated else color, edgecolors=color, zorder=2)
        axis.annotate(row.choice.label, (x, y), fontsize=6, xytext=(4, 3), textcoords="offset points")
    axis.set_xscale("log")
    axis.set_xlabel("frames per second")
    axis.set_ylabel("PSNR against the full model, dB (top: the full model itself)")
    axis.set_title(title, fontsize=9)
    axis.grid(alpha=0.3)
    chart.tight_layout()
    with atomic(path) as temporary:
        chart.savefig(temporary, dpi=120)
    pyplot.close(chart)
