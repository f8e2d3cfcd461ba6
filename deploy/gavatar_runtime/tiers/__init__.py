"""Tiers: how an avatar's Gaussians are decoded, from the full networks to a still set. One file a tier.

A tier is a class that is constructed as `factory(options, parts=Parts)` and called as `tier(pose)`; its name in the
registry is what `gavatar-play --tier` takes. What it reads is written by the component of the same name in
`gavatar.registry.TIERS`; the names of members stand in `members`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Protocol

import numpy as np

from ..bundle import Bundle
from ..components import Registry
from ..decoding.detail import grown
from ..decoding.residuals import Attributes
from ..errors import UserError, WrongValue
from ..plugins import load_entry_points
from ..values.array_rules import ADVICE
from ..values.surface import Atlas, Surface
from .members import OUTPUTS, ArrayMember


@dataclasses.dataclass(frozen=True, eq=False)
class Parts:
    """What a tier is made from. surface: of all Gaussians that the bundle holds. map_surface: of the positional map,
    None if static. threads: that decode, None for one a core. chosen: which N of the Gaussians are wanted, None for
    all. added: the variance, square metres, that each of those gains (`detail.first`)."""

    bundle: Bundle
    surface: Surface
    map_surface: Atlas | None
    threads: int | None = None
    chosen: np.ndarray | None = None
    added: np.ndarray | None = None

    def __len__(self) -> int:
        """How many Gaussians are wanted, N."""
        return len(self.surface) if self.chosen is None else len(self.chosen)

    def take(self, rows: np.ndarray) -> np.ndarray:
        """The wanted ones of one row a Gaussian of the bundle."""
        return rows if self.chosen is None else np.ascontiguousarray(rows[self.chosen])

    def grow(self, scales: np.ndarray) -> np.ndarray:
        """Scales of the wanted Gaussians at the level of detail."""
        return scales if self.added is None else grown(scales, self.added)

    def check(self, attributes: Attributes, member: str, rows: int | None = None) -> Attributes:
        """The attributes; UserError when `member` gave another shape than one row a Gaussian of the bundle, or than the
        `rows` asked for, and for NaN and infinity."""
        N = len(self.surface) if rows is None else rows
        shapes = tuple(a.shape for a in attributes)
        if shapes != ((N, 3), (N, 3), (N,)):
            found = ", ".join(map(str, shapes))
            raise UserError(f"{self.bundle.path}: {member} returns shapes {found} for {N} Gaussians; {ADVICE}")
        for name, array in zip(OUTPUTS, attributes, strict=True):
            if not np.isfinite(array).all():
                raise UserError(f"{self.bundle.path}: {member} gives NaN or infinite '{name}'; {ADVICE}")
        return attributes

    def arrays(self, member: ArrayMember) -> dict[str, np.ndarray]:
        """The arrays of an .npz member; UserError naming the first that is not there or breaks its rule."""
        sizes = {"N": len(self.surface), "body_joints": self.surface.num_joints}
        return member.read(self.bundle.arrays(member.file), f"{self.bundle.path}: {member.file}", sizes)


class Tier(Protocol):
    """members: of the bundle, that it reads beside the surface. moves: whether the result depends on the pose; if not,
    it is decoded once. networks: whether it runs networks over Gaussians in each frame, so that fewer of these or fewer
    decodes pay. picks: whether it can decode some Gaussians only: then it is also called as `tier(pose, rows)` with
    their numbers (M,) int32, and gives M; of the class, whether a bundle can let it. stage_seconds: what the last call
    spent on `encode` and `decode`."""

    members: tuple[str, ...]
    moves: bool
    networks: bool
    picks: bool
    stage_seconds: dict[str, float]

    def __call__(self, pose: np.ndarray) -> Attributes:
        """pose: (J, 3) axis-angle, float32, finite -> points (N, 3) canonical, metres, colors (N, 3) sRGB in [0, 1],
        scales (N,) metres, float32. The arrays may be filled again two calls later."""


class PickingTier(Tier, Protocol):
    """A tier that `picks`."""

    def __call__(self, pose: np.ndarray, rows: np.ndarray | None = None) -> Attributes:
        """See `Tier`. rows: which Gaussians to decode, None for all."""


class LinearTier(Tier, Protocol):
    """A tier that is `linear`: a still look, and what a pose adds to it linear in a few coefficients."""

    def linear(self) -> tuple[Attributes, Mapping[str, np.ndarray] | None]:
        """The still look, and the arrays of `members.BLENDSHAPE` for the Gaussians that are wanted, None where nothing
        is added."""


@dataclasses.dataclass(frozen=True)
class TierTraits:
    """linear: it is a `LinearTier`, which programs without networks can play."""

    linear: bool = False


PLAYER_TIERS: Registry[Tier] = Registry("tier", TierTraits)


def player_tiers() -> Registry[Tier]:
    """The registry of tiers, filled by the modules of this package."""
    import importlib
    import pkgutil

    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    return PLAYER_TIERS


def build_tier(name: str, parts: Parts) -> Tier:
    """The tier `name` of a bundle. UserError for an unknown name, for one that the bundle does not hold, and for what
    of it cannot be read."""
    tiers, stored = player_tiers(), stored_tiers(parts.bundle)
    if name not in tiers:
        load_entry_points()
    tiers[name]  # an unknown name is told from one that this bundle lacks
    if name not in stored:
        raise WrongValue(
            f"{parts.bundle.path} holds no tier '{name}' (it has {', '.join(stored)}); export it again with "
            f"gavatar-export RUN --tiers {name}"
        )
    return tiers.build(name, parts=parts)


def members_read(members: Iterable[str], stored: Iterable[str], tiers: Iterable[str]) -> set[str]:
    """Of the members of a bundle that stores some tiers, those that playing it by `tiers` reads: all but those that
    belong to others."""
    readers, members, tiers = player_tiers(), set(members), set(tiers)
    of_tier = {name: set(readers[name].kind.members) for name in {*stored, *tiers}}
    read = set().union(*(of_tier[name] for name in tiers))
    return (members - set().union(*of_tier.values())) | (read & members)


def stored_tiers(bundle: Bundle) -> list[str]:
    """Names of the tiers that a bundle holds, the default one first, which every bundle does."""
    default, tiers = player_tiers().default, bundle.manifest.tiers
    return [default, *(str(t.get("name")) for t in tiers if isinstance(t, dict) and t.get("name") != default)]
