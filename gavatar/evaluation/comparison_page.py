"""One page of many runs: the table of `gavatar-eval --all` with pictures, in one file that needs nothing else."""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np

from ..storage import atomic, write_image

PREVIEW_HEIGHT = 160  # pixels: a person can be told from a blot
MOST_INSIDE = 3000  # rows; a picture takes 8 kB, and browsers grow slow with pages of more than some 30 MB

STYLE = """
:root { color-scheme: light dark; font: 14px/1.4 system-ui, sans-serif; }
body { margin: 1.5rem; background: Canvas; color: CanvasText; }
table { border-collapse: collapse; }
th, td { padding: .3rem .7rem; text-align: right; border-bottom: 1px solid color-mix(in srgb, CanvasText 20%, Canvas); }
th { position: sticky; top: 0; background: Canvas; cursor: pointer; user-select: none; }
th:hover, th[aria-sort] { text-decoration: underline; }
td.word, th:nth-child(-n+3) { text-align: left; }
img { display: block; height: 120px; border-radius: 4px; }
.faults td { text-align: left; white-space: pre-wrap; }
"""
# a click on a column's head sorts the rows by it, again: the other way round
SCRIPT = """
for (const table of document.querySelectorAll("table"))
  table.tHead.rows[0].addEventListener("click", ({ target }) => {
    const head = target.closest("th"), down = head.ariaSort === "descending";
    for (const other of head.parentNode.cells) other.ariaSort = null;
    head.ariaSort = down ? "ascending" : "descending";
    const value = row => row.cells[head.cellIndex].dataset.value ?? row.cells[head.cellIndex].textContent;
    const order = (a, b) => (isNaN(a) || isNaN(b) || a === "" || b === "" ? a.localeCompare(b) : a - b);
    const rows = [...table.tBodies[0].rows].sort((a, b) => order(value(a), value(b)));
    table.tBodies[0].append(...(down ? rows : rows.reverse()));
  });
"""


def write_preview(path: Path, target: np.ndarray, render: np.ndarray) -> None:
    """Footage and avatar side by side, as a small JPEG. target, render: (H, W, 3) in [0, 1]."""
    pair = np.concatenate([target, np.clip(render, 0, 1)], 1).astype(np.float32)
    width = max(1, round(pair.shape[1] * PREVIEW_HEIGHT / pair.shape[0]))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, cv2.resize(pair, (width, PREVIEW_HEIGHT), interpolation=cv2.INTER_AREA))


def write_page(
    path: Path,
    title: str,
    rows: Sequence[Mapping[str, Any]],
    columns: Mapping[str, tuple[str, int]],
    previews: Sequence[Path],
    faults: Iterable[tuple[str, str]],
) -> None:
    """Write the page. columns: title of a column -> key in a row, and decimals. previews: a JPEG for each row; one that
    is missing is left out. Pictures of more than `MOST_INSIDE` rows stay files, which the page refers to and says so.
    faults: (run, what is wrong with it)."""
    inside = len(rows) <= MOST_INSIDE
    said = "" if inside else " Pictures are files in the runs: keep the page beside them."
    heads = ["run", "split", "poses", "stage", "Gaussians", "views", *columns, "footage and avatar, worst view"]
    lines = [
        "<!doctype html>", '<html lang="en">', '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width">', f"<title>{html.escape(title)}</title>",
        f"<style>{STYLE}</style>", f"<h1>{html.escape(title)}</h1>",
        f"<p>{len({row['run'] for row in rows})} runs. Whole frames on white. A click on a title sorts.{said}</p>",
        _head(heads),
    ]  # fmt: skip
    for row, preview in zip(rows, previews, strict=True):
        words = [str(row[key]) for key in ("run", "split", "poses")]
        cells = [f'<td class="word">{html.escape(word)}</td>' for word in words]
        cells += [f"<td>{row[key]}</td>" for key in ("stage", "gaussians", "views")]
        cells += [_number(row[key], digits) for key, digits in columns.values()]
        cells.append(f'<td data-value="{row["psnr"]}">{_picture(preview, words, None if inside else path.parent)}</td>')
        lines.append("<tr>" + "".join(cells) + "</tr>")
    lines.append("</tbody></table>")
    told = list(faults)
    if told:
        lines += ["<h2>Without a result</h2>", _head(["run", "why"]).replace("<table>", '<table class="faults">')]
        lines += [f"<tr><td>{html.escape(run)}</td><td>{html.escape(why)}</td></tr>" for run, why in told]
        lines.append("</tbody></table>")
    lines.append(f"<script>{SCRIPT}</script>")
    with atomic(path) as temporary:
        Path(temporary).write_text("\n".join(lines) + "\n", encoding="utf-8")


def job_faults(folder: Path) -> list[tuple[str, str]]:
    """(run, what became of it) of the jobs in folder/jobs that did not end well, as `gavatar-train --multirun` left
    them."""
    found = []
    for path in sorted((folder / "jobs").rglob("*.json")):
        said = json.loads(path.read_text(encoding="utf-8"))
        if said["code"] == 0:
            continue
        why = f"exit code {said['code']}: {said['message'].strip()}"
        if said["state"] == "running":
            why = f"no end was written: it still runs, or was killed (on {said['host']}, begun {said['started']})"
        found.append((said["run"], f"{why}\n{path.with_suffix('.log')}"))
    return found


def _head(titles: Iterable[str]) -> str:
    return "<table><thead><tr>" + "".join(f"<th>{html.escape(t)}</th>" for t in titles) + "</tr></thead><tbody>"


def _number(value: float | None, digits: int) -> str:
    return "<td></td>" if value is None else f'<td data-value="{value}">{value:.{digits}f}</td>'


def _picture(path: Path, words: Sequence[str], beside: Path | None) -> str:
    """The picture itself, or with `beside`, the page's folder, where it lies."""
    if not path.exists():
        return ""
    if beside is None:
        source = f"data:image/jpeg;base64,{base64.b64encode(path.read_bytes()).decode()}"
    else:
        source = quote(Path(os.path.relpath(path, beside)).as_posix())
    return f'<img loading="lazy" alt="{html.escape(" ".join(words))}" src="{source}">'
