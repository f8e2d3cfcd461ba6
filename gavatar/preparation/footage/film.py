"""One camera's raw material: image files or a video, at the moments of an even clock."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gavatar_runtime.errors import UserError

from .listing import number_order_note, twice
from .pictures import read_frame
from .time_stamps import even_clock
from .video_reading import video_facts, video_frames


@dataclasses.dataclass(frozen=True)
class Film:
    """frames: image files or a video. stems: names of all its frames' masks. order: (T,) the frame of each moment.
    rate: moments a second, None when unknown. size: (width, height). notes: sentences for the user."""

    name: str
    frames: list[Path] | Path
    stems: list[str]
    order: np.ndarray
    rate: float | None
    size: tuple[int, int]
    notes: list[str]

    @staticmethod
    def of(name: str, frames: list[Path] | Path, resample: bool = True) -> Film:
        """resample: take frames by their time stamps where these are uneven, else each once. Raises UserError for what
        cannot be read."""
        if isinstance(frames, Path):
            facts = video_facts(frames)
            timing, every = even_clock(facts.stamps, facts.rate, facts.count), np.arange(facts.count)
            notes = [*facts.notes, *([f"{name}: {timing.note}"] if timing.note and resample else [])]
            stems = [f"{k:06d}" for k in range(facts.count)]
            return Film(name, frames, stems, timing.order if resample else every, timing.rate, facts.size, notes)
        twice(frames)
        size = read_frame(frames[0]).shape[1::-1]
        return Film(name, frames, [p.stem for p in frames], np.arange(len(frames)), None, size,
                    number_order_note(name, frames))  # fmt: skip

    @property
    def even(self) -> bool:
        """Whether every frame is taken once."""
        return np.array_equal(self.order, np.arange(len(self.stems)))

    def images(self, numbers: np.ndarray) -> Iterator[np.ndarray]:
        """(H, W, 3) uint8 BGR of those frames. UserError for one that cannot be read or has another size."""
        if isinstance(self.frames, Path):
            yield from video_frames(self.frames, numbers)
            return
        for number in numbers:
            path = self.frames[number]
            image = read_frame(path)
            if image.shape[1::-1] != self.size:
                raise UserError(
                    f"{path} is {image.shape[1]}x{image.shape[0]} pixels, but {self.frames[0].name} is "
                    f"{self.size[0]}x{self.size[1]}: frames of one camera have one size"
                )
            yield image
