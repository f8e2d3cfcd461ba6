"""Decodes that serve more than one frame: of what does not move, one for all; of what does, one every few frames."""

from __future__ import annotations

from time import perf_counter
from typing import Protocol, cast

import numpy as np

from ..decoding.network import CHUNK
from ..decoding.residuals import Attributes, empty
from ..geometry.spacing import evenly_spaced
from ..tiers import PickingTier, Tier
from .buffers import InTurn

TRIED = CHUNK + 64  # Gaussians decoded when an avatar is opened: more than a graph takes at once


class Decoder(Protocol):
    """What gives the attributes of all Gaussians in a pose: a tier, or one that is spared calls.

    stage_seconds: what the last call spent on `encode` and `decode`.
    """

    stage_seconds: dict[str, float]

    def __call__(self, pose: np.ndarray) -> Attributes:
        """As `Tier` has it."""
        raise NotImplementedError


class Sparing:
    """A tier of `count` Gaussians that is called as rarely as will do: once where it does not move, else at every
    `reuse`-th call (`Faded`), and for no more than the Gaussians asked for.

    stage_seconds: as of `Decoder`.
    """

    def __init__(self, tier: Tier, reuse: int, count: int):
        self.networks = tier.networks and tier.moves
        self.picks = self.networks and tier.picks and reuse == 1
        self.stage_seconds: dict[str, float] = {}
        self._tier, self._decoder = tier, _spared(tier, reuse, count)

    def __call__(self, pose: np.ndarray, rows: np.ndarray | None = None) -> Attributes:
        """rows: (M,) int32, only where it `picks`; None for all."""
        if rows is not None and not len(rows):
            self.stage_seconds = undecoded()
            return empty(0)
        if rows is None:
            attributes, source = self._decoder(pose), self._decoder
        else:
            attributes, source = cast(PickingTier, self._tier)(pose, rows), self._tier
        self.stage_seconds = dict(source.stage_seconds)
        return attributes

    def tried(self, pose: np.ndarray, count: int) -> Sparing:
        """Itself, after it decoded a pose, so that what cannot be decoded is refused when the avatar is opened: of what
        does not move all, which is kept; else `TRIED` of the `count` Gaussians where the tier can pick."""
        if not self._tier.moves:
            self._decoder(pose)
        elif self._tier.picks:
            cast(PickingTier, self._tier)(pose, evenly_spaced(count, TRIED).astype(np.int32))
        else:
            self._tier(pose)
        return self


def _spared(tier: Tier, reuse: int, count: int) -> Decoder:
    if not tier.moves:
        return Once(tier)
    return tier if reuse == 1 else Faded(tier, reuse, count)


def undecoded() -> dict[str, float]:
    """The seconds of a frame that nothing is decoded for."""
    return {"encode": 0.0, "decode": 0.0}


class Once(Decoder):
    """Decodes at the first call: for a tier that does not move."""

    def __init__(self, tier: Decoder):
        self._tier = tier
        self._kept: Attributes | None = None
        self.stage_seconds = undecoded()

    def __call__(self, pose: np.ndarray) -> Attributes:
        """See `Decoder`."""
        if self._kept is not None:
            self.stage_seconds = undecoded()
            return self._kept
        self._kept = self._tier(pose)
        self.stage_seconds = self._tier.stage_seconds
        return self._kept


class Faded(Decoder):
    """Decodes `count` Gaussians at every `every`-th call, and fades from one result to the next in the calls between,
    which therefore lag by as many. It takes the calls for the frames of one motion."""

    def __init__(self, tier: Decoder, every: int, count: int):
        self._tier, self._every = tier, every
        self._ends = empty(count), empty(count)
        self._between = InTurn(lambda: empty(count))
        self._phase, self._begun = -1, False
        self.stage_seconds = undecoded()

    def __call__(self, pose: np.ndarray) -> Attributes:
        """See `Decoder`."""
        self._phase = (self._phase + 1) % self._every
        if self._phase == 0 or not self._begun:
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
        """Fade to `latest` from what was faded to before, at first from itself."""
        self._ends = self._ends[1], self._ends[0]
        for filled in self._ends[1:] if self._begun else self._ends:
            for kept, array in zip(filled, latest, strict=True):
                np.copyto(kept, array)
        self._begun = True
