"""Decodes that serve more than one frame: of what does not move, one for all; of what does, one every few frames."""

from __future__ import annotations

from time import perf_counter
from typing import Protocol

import numpy as np

from ..decoding.residuals import Attributes, empty
from ..tiers import Tier
from .buffers import InTurn


class Decoder(Protocol):
    """What gives the attributes of all Gaussians in a pose: a tier, or one that is spared calls.

    stage_seconds: what the last call spent on `encode` and `decode`.
    """

    stage_seconds: dict[str, float]

    def __call__(self, pose: np.ndarray) -> Attributes:
        """As `Tier` has it."""
        raise NotImplementedError


def undecoded() -> dict[str, float]:
    """The seconds of a frame that nothing is decoded for."""
    return {"encode": 0.0, "decode": 0.0}


class Once(Decoder):
    """Decodes at the first call: for a tier that does not move."""

    def __init__(self, tier: Tier):
        self._tier, self._kept = tier, None
        self.stage_seconds = undecoded()

    def __call__(self, pose: np.ndarray) -> Attributes:
        """See `Decoder`."""
        if self._kept is None:
            self._kept = self._tier(pose)
            self.stage_seconds = self._tier.stage_seconds
        else:
            self.stage_seconds = undecoded()
        return self._kept


class Faded(Decoder):
    """Decodes `count` Gaussians at every `every`-th call, and fades from one result to the next in the calls between,
    which therefore lag by as many. It takes the calls for the frames of one motion."""

    def __init__(self, tier: Tier, every: int, count: int):
        self._tier, self._every = tier, every
        self._ends: tuple[Attributes, Attributes] | None = None
        self._between = InTurn(lambda: empty(count))
        self._phase = -1
        self.stage_seconds = undecoded()

    def __call__(self, pose: np.ndarray) -> Attributes:
        """See `Decoder`."""
        self._phase = (self._phase + 1) % self._every
        if self._phase == 0 or self._ends is None:
            self._go_on(self._tier(pose))
            self.stage_seconds = dict(self._tier.stage_seconds)
        else:
            self.stage_seconds = undecoded()
        start = perf_counter()
        share = np.float32((self._phase + 1) / self._every)
        mixed = self._between.next()
        for a, b, out in zip(*self._ends, mixed, strict=True):
            np.subtract(b, a, out=out)
            np.multiply(out, share, out=out)
            np.add(out, a, out=out)
        self.stage_seconds["decode"] += perf_counter() - start
        return mixed

    def _go_on(self, latest: Attributes) -> None:
        """Fade to `latest` from what was faded to before."""
        if self._ends is None:
            self._ends = tuple(tuple(array.copy() for array in latest) for _ in range(2))
            return
        self._ends = self._ends[1], self._ends[0]
        for kept, array in zip(self._ends[1], latest, strict=True):
            np.copyto(kept, array)
