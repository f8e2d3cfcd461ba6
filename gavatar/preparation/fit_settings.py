"""The numbers that preparing takes, and between what they may lie. Needs no library, so that a command can show its
help at once."""

from __future__ import annotations

from collections.abc import Mapping

from gavatar_runtime.errors import WrongValue

MOST_FRAMES, LARGEST = 200, 1024  # of raw video; pixels of the longer side
FITTED_BETAS = 10  # official files have 16 or 300; beyond ten, one person's outline says next to nothing
RANGES = {
    "fps": (0, 10000),
    "max_frames": (0, 100000),
    "size": (16, 16384),
    "fov": (1, 170),
    "height": (0.5, 2.6),
    "num_betas": (0, 400),
}


def check_numbers(values: Mapping[str, float | None]) -> None:
    """WrongValue for a number out of its range."""
    for name, value in values.items():
        low, high = RANGES[name]
        if value is not None and not low < value <= high:
            raise WrongValue(f"`{name}={value:g}` is out of range: give more than {low} and at most {high}")
