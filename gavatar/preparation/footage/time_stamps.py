"""When frames were taken: a constant rate from time stamps that need not be even."""

from __future__ import annotations

import dataclasses

import numpy as np

FASTEST = 500.0  # frames a second that footage may claim without time stamps to show it: browsers write 1000
AGREE = 0.02  # of a rate: what a container says and what its time stamps say may differ so much by rounding
OFF = 0.6  # of a frame: time stamps this near to an even grid are even (one lost frame moves them by half of one)


@dataclasses.dataclass(frozen=True)
class Timing:
    """order: (T,) source frame of each moment of an even clock, repeated or left out where the source is uneven. rate:
    moments a second, None when unknown. note: what to say of it."""

    order: np.ndarray
    rate: float | None
    note: str | None = None

    @property
    def even(self) -> bool:
        """Whether every frame of the source is taken once."""
        return np.array_equal(self.order, np.arange(len(self.order)))


def even_clock(stamps: np.ndarray | None, said: float | None, count: int) -> Timing:
    """stamps: (count,) seconds at which the frames are shown, or None. said: the rate in the file's header.

    Where the stamps are even the header is believed, unless it says something else than they do. Where they are not,
    every moment of an even clock takes the frame nearest in time.
    """
    every = np.arange(count)
    mean = None
    if stamps is not None and len(stamps) == count > 2 and np.isfinite(stamps).all() and (np.diff(stamps) > 0).all():
        mean = float(stamps[-1] - stamps[0]) / (count - 1)
    rate = 1 / mean if mean else said
    if rate is not None and rate > FASTEST:
        return Timing(every, None, f"the file says {rate:.4g} frames a second, which no camera films")
    if stamps is None or mean is None:
        return Timing(every, said)
    steps = np.diff(stamps)
    if np.abs(stamps - stamps[0] - mean * every).max() <= OFF * mean:
        if said is not None and abs(said * mean - 1) <= AGREE:
            return Timing(every, said)
        note = (
            f"the file says {said:.4g} frames a second, its time stamps {1 / mean:.4g}, which is taken"
            if said
            else None
        )
        return Timing(every, 1 / mean, note)
    usual = float(steps[np.abs(steps - np.median(steps)) <= 0.25 * np.median(steps)].mean())
    step = usual if (stamps[-1] - stamps[0]) / usual < 4 * count else mean  # else it is mostly pauses
    clock = stamps[0] + step * np.arange(int(np.floor((stamps[-1] - stamps[0]) / step + 0.5)) + 1)
    after = np.clip(np.searchsorted(stamps, clock), 1, count - 1)
    order = np.where(clock - stamps[after - 1] <= stamps[after] - clock, after - 1, after)
    repeated, left_out = len(order) - len(np.unique(order)), count - len(np.unique(order))
    return Timing(order, 1 / step, (
        f"its frames are not evenly spaced ({1 / steps.max():.3g} to {1 / steps.min():.3g} a second): they are taken "
        f"by their time stamps at {1 / step:.4g} a second, {repeated} of them repeated, {left_out} left out (a rate "
        "given as `fps` takes each once)"
    ))  # fmt: skip
