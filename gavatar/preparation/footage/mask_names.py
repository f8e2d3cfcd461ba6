"""Which mask belongs to which frame, by name, by number or, where they are as many, by order."""

from __future__ import annotations

import re
from pathlib import Path

from gavatar_runtime.errors import UserError

from .listing import IMAGE_SUFFIXES, footage_files


def match_masks(folder: Path, stems: list[str], chosen: list[int]) -> tuple[list[Path], str | None]:
    """Mask files of the frames `stems[k]` for k in `chosen`, and how they were matched if not by their names.

    In this order: NAME.png; one prefix and suffix around all names (NAME_mask.png, NAME.jpg.mask.png); the number that
    counts the files; as many masks as frames, in order. UserError names the first mask that is missing.
    """
    files = footage_files(folder, IMAGE_SUFFIXES)
    exact = _by_stem(files)
    if all(stems[k] in exact for k in chosen):
        return [exact[stems[k]] for k in chosen], None
    wanted = sorted(set(chosen))
    for found, how in ((_by_affixes, None), (_by_numbers, "by their numbers"), (_by_order, "by their order")):
        match = found(files, stems)
        if match and all(k in match for k in wanted):
            said = how and f"{folder}: masks are matched to frames {how}: {match[wanted[0]].name} is that of " \
                           f"{stems[wanted[0]]}, {match[wanted[-1]].name} that of {stems[wanted[-1]]}"  # fmt: skip
            return [match[k] for k in chosen], said
    missing = [stems[k] for k in chosen if stems[k] not in exact]
    others = f"; it holds {len(files)} images, such as {files[0].name}" if files else ""
    raise UserError(
        f"{folder / missing[0]}.png is missing ({len(missing)} of {len(chosen)} masks): every frame needs its mask, "
        f"named as the frame{others}"
    )


def _by_stem(files: list[Path]) -> dict[str, Path]:
    """One file of each stem, .png before the rest."""
    return {p.stem: p for p in sorted(files, key=lambda p: p.suffix.lower() == ".png")}


def _by_affixes(files: list[Path], stems: list[str]) -> dict[int, Path]:
    """The one prefix and suffix around the frames' names with which most of them have a mask."""
    names = _by_stem(files)
    best: dict[int, Path] = {}
    for probe in {stems[0], stems[-1]}:
        for name in names:
            for at in (m.start() for m in re.finditer(f"(?={re.escape(probe)})", name)):
                before, after = name[:at], name[at + len(probe) :]
                if (before[-1:].isdigit() and probe[:1].isdigit()) or (after[:1].isdigit() and probe[-1:].isdigit()):
                    continue  # 1 is not in 10_mask
                found = {k: names[f"{before}{s}{after}"] for k, s in enumerate(stems) if f"{before}{s}{after}" in names}
                best = max(best, found, key=len)
    return best


def _by_numbers(files: list[Path], stems: list[str]) -> dict[int, Path]:
    """Masks with a frame's number, whatever its zeros; nothing unless every frame's is there."""
    of_files, of_stems = _counting([p.stem for p in files]), _counting(stems)
    if of_files is None or of_stems is None:
        return {}
    by_number = dict(zip(of_files, files, strict=True))
    return {k: by_number[n] for k, n in enumerate(of_stems)} if set(of_stems) <= set(by_number) else {}


def _by_order(files: list[Path], stems: list[str]) -> dict[int, Path]:
    return dict(enumerate(files)) if len(files) == len(stems) else {}


def _counting(names: list[str]) -> list[int] | None:
    """The number in each name that differs everywhere, None where there is none."""
    runs = [[int(run) for run in re.findall(r"\d+", name)] for name in names]
    if not runs or len({len(run) for run in runs}) != 1:
        return None
    columns = [list(column) for column in zip(*runs, strict=True)]
    return next((column for column in reversed(columns) if len(set(column)) == len(names)), None)
