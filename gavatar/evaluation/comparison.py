"""Several runs in one table: what `gavatar-eval --all DIR` makes of those in a folder."""

from __future__ import annotations

import csv
import dataclasses
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gavatar_runtime.errors import UserError

from ..storage import atomic, write_json
from ..text_table import format_table
from ..training.places import CONFIG
from .comparison_page import write_page

# of a row of a run, with the decimals of its column; a column that no run has is left out
COLUMNS = {
    "PSNR": ("psnr", 2), "SSIM": ("ssim", 4), "perceptual": ("perceptual", 4), "worst PSNR": ("worst_psnr", 2),
    "MPJPE": ("mpjpe_mm", 1), "PA-MPJPE": ("pa_mpjpe_mm", 1),
}  # fmt: skip


def runs_in(folder: Path) -> list[Path]:
    """Every run directory in a folder, itself included, however deep, in the order of their names. Raises UserError
    where there is none."""
    if not folder.is_dir():
        raise UserError(f"{folder} is not a directory")
    found = []
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        if CONFIG in files:
            found.append(Path(place))
    if not found:
        raise UserError(f"no run is in {folder}: gavatar-train writes them, each with its {CONFIG}")
    return sorted(found)


def preview_of(place: Path, row: Mapping[str, Any]) -> Path:
    """Where the small picture of a row's worst view lies. place: where its evaluation.json does."""
    return place / "evaluation_views" / f"{row['split']}_{row['poses']}.jpg"


@dataclasses.dataclass
class Comparison:
    """Rows of all runs. rows: as in evaluation.json, with `run`, its path in the folder, `stage` and `gaussians`
    before. previews: of each row, its small picture. Prints as a table."""

    rows: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    previews: list[Path] = dataclasses.field(default_factory=list)

    def add(self, name: str, result: Mapping[str, Any], place: Path) -> None:
        """The rows of an evaluated run. result: what its evaluation.json, which lies in `place`, holds."""
        about = {"run": name, "stage": result["stage"], "gaussians": result["gaussians"]}
        self.rows += [about | row for row in result["rows"]]
        self.previews += [preview_of(place, row) for row in result["rows"]]

    def columns(self) -> dict[str, tuple[str, int]]:
        """The columns that a run has something for."""
        return {title: c for title, c in COLUMNS.items() if any(row[c[0]] is not None for row in self.rows)}

    def __str__(self) -> str:
        columns = self.columns()
        header = ["run", "split", "poses", "stage", "Gaussians", "views", *columns]
        cells = [
            [row["run"], row["split"], row["poses"], str(row["stage"]), str(row["gaussians"]), str(row["views"])]
            + ["-" if row[key] is None else f"{row[key]:.{digits}f}" for key, digits in columns.values()]
            for row in self.rows
        ]
        return format_table(header, cells)

    def write_json(self, path: str | os.PathLike[str]) -> None:
        """Write the rows as a list."""
        write_json(path, self.rows)

    def write_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the rows with a header; what a row has no value for is empty."""
        with atomic(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(_keys(self.rows)))
            writer.writeheader()
            writer.writerows(self.rows)

    def write_html(self, path: Path, title: str, faults: Iterable[tuple[str, str]] = ()) -> None:
        """Write a page with pictures. faults: (run, why) of those that have no rows."""
        write_page(path, title, self.rows, self.columns(), self.previews, faults)


def _keys(rows: Iterable[dict[str, Any]]) -> dict[str, None]:
    """Every key of the rows, in the order of its first appearance."""
    return {key: None for row in rows for key in row}
