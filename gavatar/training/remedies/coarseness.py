"""How coarse on the body what depends on the pose is: light and folds are, texture is not."""

from __future__ import annotations

import weakref

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.values.surface import Surface

from ...attributes import Attributes
from ...avatar.trainable import Avatar
from ..scene import Scene
from .prior import measured

RADIUS = 0.05  # metres in the canonical pose: what is finer than this is texture
LOOKED_AT = 8192  # points that the penalty looks at, each with `AROUND` others of those about it
AROUND = 16
NEXT = 6  # points that lie about each of an even sampling
MEASURED_POINTS, MEASURED_VIEWS = 2000, 32


def surroundings(points: np.ndarray, seed: int, count: int = LOOKED_AT, around: int = AROUND) -> tuple[Tensor, Tensor]:
    """(M,) indices of at most `count` of the points (N, 3), metres, drawn at random, and (M, around) indices of points
    within `RADIUS` of each, itself among them; drawn with replacement."""
    random = np.random.default_rng(seed)
    chosen = np.sort(random.permutation(len(points))[:count])
    balls = cKDTree(points).query_ball_point(points[chosen], RADIUS)
    near = np.stack([random.choice(ball, around) for ball in balls]) if len(chosen) else np.zeros((0, around), int)
    return torch.from_numpy(chosen), torch.from_numpy(near)


class FinePart:
    """The part of what points carry that is finer than `RADIUS`, at some of the points; those are drawn anew for each
    surface."""

    def __init__(self) -> None:
        self._known: tuple[weakref.ref[Surface], Tensor, Tensor] | None = None

    def __call__(self, values: Tensor, surface: Surface) -> Tensor:
        """(B, N, C) on the points of `surface` -> (B, M, C) less the mean of those around."""
        if self._known is None or self._known[0]() is not surface:
            self._known = weakref.ref(surface), *surroundings(surface.points, len(surface.points))
        chosen, near = (index.to(values.device) for index in self._known[1:])
        mean = values[:, near.flatten()].unflatten(1, near.shape).mean(2)
        return values[:, chosen] - mean


class ToNeighbours:
    """What points carry, less what one of those next to each carries; who is next is found anew for each surface."""

    def __init__(self) -> None:
        self._known: tuple[weakref.ref[Surface], Tensor] | None = None

    def __call__(self, values: Tensor, surface: Surface, step: int) -> Tensor | None:
        """(B, N, C) on the points of `surface` -> the same less those of a neighbour, another of the `NEXT` nearest in
        the canonical pose each step; None of a single point."""
        if len(surface) < 2:
            return None
        if self._known is None or self._known[0]() is not surface:
            near = cKDTree(surface.points).query(surface.points, min(NEXT + 1, len(surface)))[1]
            self._known = weakref.ref(surface), torch.from_numpy(near[:, 1:].copy())
        near = self._known[1]
        return values - values[:, near[:, step % near.shape[1]].to(values.device)]


class Unevenness:
    """How what an avatar decodes to differs from point to point, for the losses that want it even."""

    def __init__(self) -> None:
        self._fine_part, self._to_neighbours = FinePart(), ToNeighbours()
        self._still: tuple[Surface, Tensor] | None = None  # colours of the one look, and where

    def with_pose(self, avatar: Avatar, attributes: Attributes, learns: bool) -> Tensor:
        """`LossInputs.pose_detail` of attributes in B poses. learns: the one look is learnt too, and another each
        step."""
        if learns or self._still is None or self._still[0] is not avatar.surface:
            with torch.no_grad():
                self._still = avatar.surface, avatar.attributes().colors
        return self._fine_part(attributes.colors - self._still[1], avatar.surface)

    def between_neighbours(self, avatar: Avatar, attributes: Attributes, step: int) -> Tensor | None:
        """`LossInputs.to_neighbours` of what was decoded."""
        return self._to_neighbours(measured(avatar, attributes), avatar.surface, step)


@torch.no_grad()
def fine_rms(scene: Scene, rows: list[int]) -> float:
    """Root mean square, over points, channels and (some of) the views in `rows`, of the part of the colours' change
    with the pose that is finer than `RADIUS`: colours in [0, 1], less those of the one look, less the mean of that over
    all points within the radius."""
    avatar = scene.avatar
    training = avatar.training
    avatar.eval()
    points, still = avatar.surface.points, avatar.attributes().colors
    chosen = np.random.default_rng(0).permutation(len(points))[:MEASURED_POINTS]
    balls = cKDTree(points).query_ball_point(points[chosen], RADIUS)
    lengths = torch.tensor([len(ball) for ball in balls], device=still.device)
    index = torch.from_numpy(np.concatenate(balls).astype(np.int64)).to(still.device)
    owner = torch.repeat_interleave(torch.arange(len(chosen), device=still.device), lengths)
    squares = []
    for row in [rows[i] for i in evenly_spaced(len(rows), MEASURED_VIEWS)]:
        change = (avatar.attributes(scene.pose_features(scene.frames_of([row]))).colors - still)[0]
        mean = change.new_zeros(len(chosen), 3).index_add_(0, owner, change[index]) / lengths[:, None]
        squares.append(float((change[torch.from_numpy(chosen)] - mean).square().mean()))
    avatar.train(training)
    return float(np.sqrt(np.mean(squares)))
