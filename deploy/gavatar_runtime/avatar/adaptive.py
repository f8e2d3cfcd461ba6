"""Keeping frames within a time budget while an avatar plays: temporal reuse first where networks run, then fewer
Gaussians."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np

from ..bundle import Bundle
from ..decoding.detail import FEWEST
from ..errors import WrongValue
from ..values.camera import Camera
from ..values.gaussians import Gaussians
from ..values.motion import Motion
from .played import PlayedAvatar
from .playing import Avatar

REUSE = (1, 2, 4, 8)
DETAIL = (0.56, 0.25, 0.14, 0.06)  # of the Gaussians
PATIENCE, RECOVERY = 4, 30  # frames looked at before it gets cheaper, and before it gets finer
TYPICAL, NEARLY_ALL = 50, 90  # percentiles: over the budget is a typical frame, well under it are nearly all
FAR = 2.0  # times the budget: so slow that two levels are skipped at once
EASE = 0.6  # of the budget: what nearly all frames must stay under for a finer level to be tried
SETTLE = 2  # frames after a change that say nothing: one was decoded before it, one opens the new level


class AdaptiveAvatar(PlayedAvatar):
    """An avatar that changes its level so that its typical frame takes no more than `budget_s` seconds.

    It looks at percentiles of the last frames at the present level, where one slow frame counts once: a running mean
    carries it along. Where decodes are reused, a frame is the mean of a turn.

    Plays like `Avatar`; the player tells it by `frame_took` how long each frame was. levels: (reuse, Gaussians)
    from the finest; None is all.
    Raises UserError for a budget that is not positive.
    """

    def __init__(self, bundle: Bundle, budget_s: float, *, tier: str = "", threads: int | None = None):
        if not budget_s > 0:
            raise WrongValue(f"a budget of {1000 * budget_s:g} ms a frame is not possible: give a positive number")
        self._make = lambda reuse, count: Avatar(bundle, tier=tier, gaussians=count, reuse=reuse, threads=threads)
        self.budget_s = budget_s
        finest = self._make(1, None)
        self.bundle, self.name, self.tier = bundle, finest.name, finest.tier
        self.pixel = finest.pixel
        self.surface, self.expression, self.evidence = finest.surface, finest.expression, finest.evidence
        self.joint_names, self.joints = finest.joint_names, finest.joints
        self.stage_seconds: dict[str, float] = {}
        reuses = REUSE if finest.networks else (1,)
        counts = [max(FEWEST, round(len(finest) * share)) for share in DETAIL]
        self.levels: list[tuple[int, int | None]] = [(reuse, None) for reuse in reuses]
        self.levels += [(reuses[-1], count) for count in dict.fromkeys(counts) if count < len(finest)]
        self.level = 0
        self.frames: Counter[int] = Counter()  # by level
        self._finest, self._avatars = finest, {0: finest}
        self._recent: deque[float] = deque(maxlen=RECOVERY + REUSE[-1])
        self._settling = 0
        self._motion: Motion | None = None

    def fit(self, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
        """See `Avatar.fit`."""
        return self._finest.fit(motion)

    def follow(self, motion: Motion | None) -> None:
        """See `Avatar.follow`."""
        self._motion = motion
        for avatar in self._avatars.values():
            avatar.follow(motion)

    def gaussians(
        self,
        pose: np.ndarray,
        trans: np.ndarray | None = None,
        expression: np.ndarray | None = None,
        *,
        camera: Camera | None = None,
        normals: bool = False,
        copy: bool = True,
    ) -> Gaussians:
        """The avatar in one pose at the present level (see `Avatar.gaussians`)."""
        level = self.level
        if level not in self._avatars:
            self._avatars[level] = self._make(*self.levels[level])
            if self._motion is not None:
                self._avatars[level].follow(self._motion)
        avatar = self._avatars[level]
        result = avatar.gaussians(pose, trans, expression, camera=camera, normals=normals, copy=copy)
        self.stage_seconds = avatar.stage_seconds
        self.frames[level] += 1
        return result

    def frame_took(self, seconds: float) -> None:
        """Note what a frame took and change the level for those to come."""
        if self._settling:
            self._settling -= 1
            return
        self._recent.append(seconds)
        turn = self.levels[self.level][0]
        costs = np.convolve(self._recent, np.full(turn, 1 / turn), "valid") if len(self._recent) >= turn else ()
        step = 0
        if len(costs) >= PATIENCE:
            typical = np.percentile(costs[-PATIENCE:], TYPICAL)
            step = 0 if typical <= self.budget_s else 1 if typical <= FAR * self.budget_s else 2
        if len(costs) >= RECOVERY and np.percentile(costs[-RECOVERY:], NEARLY_ALL) < EASE * self.budget_s:
            step = -1
        level = min(max(0, self.level + step), len(self.levels) - 1)
        if level != self.level:
            self.level, self._settling = level, SETTLE
            self._recent.clear()

    def report(self) -> list[dict]:
        """Frames played at each level that was used, the finest first."""
        return [
            {"reuse": self.levels[i][0], "gaussians": self.levels[i][1], "frames": count}
            for i, count in sorted(self.frames.items())
        ]
