"""What the web player draws of an avatar: a still set of Gaussians, and the residuals of the pose as bases."""

from __future__ import annotations

import dataclasses
from typing import cast

import numpy as np

from ..avatar.playing import Avatar
from ..avatar.pose_blendshapes import MEMBER as POSE_BLENDSHAPES
from ..decoding.detail import added_variance, grown
from ..errors import WrongValue
from ..geometry.kinematics import invert_rigid
from ..motions.builtin import relaxed_pose
from ..tiers import LinearTier, Parts, build_tier, player_tiers, stored_tiers
from ..values.motion import Motion


@dataclasses.dataclass(frozen=True, eq=False)
class StillLook:
    """N Gaussians of an avatar in its canonical pose, and what a pose does to them.

    tier: the one it was taken from. points: (N, 3) metres. colors: (N, 3) in [0, 1]. scales, spacing: (N,) metres.
    rank: (N,) places in the progressive order.
    joint_index, joint_weight: (N, K). parents: (J,). rest: (J, 3) metres. inverse: (J, 3, 4), canonical to rest.
    relaxed: (J, 3) axis-angle of standing at ease. residual: the arrays of blendshape.npz, None for one look for all
    poses. pixel: metres that a training pixel spanned, or None. notes: what the page leaves out, a sentence each.
    """

    name: str
    tier: str
    points: np.ndarray
    colors: np.ndarray
    scales: np.ndarray
    spacing: np.ndarray
    rank: np.ndarray
    joint_index: np.ndarray
    joint_weight: np.ndarray
    joint_names: tuple[str, ...]
    parents: np.ndarray
    rest: np.ndarray
    inverse: np.ndarray
    relaxed: np.ndarray
    pixel: float | None
    residual: dict[str, np.ndarray] | None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.points)

    def thinned(self, count: int) -> StillLook:
        """With the first `count` Gaussians of the progressive order, each grown as the gaps ask for; as it is where it
        has no more. Raises WrongValue for fewer than one."""
        if count < 1:
            raise WrongValue(f"`gaussians={count}`: give a whole number from 1 up")
        if count >= len(self):
            return self
        rows = np.flatnonzero(self.rank < count)
        added = added_variance(self.spacing[rows], len(self) / count)
        residual = self.residual
        if residual is not None:
            residual = {**residual, **{name: residual[name][rows] for name in ("part", "basis")}}
        return dataclasses.replace(
            self, points=self.points[rows], colors=self.colors[rows], scales=grown(self.scales[rows], added),
            spacing=self.spacing[rows] * np.sqrt(len(self) / count).astype(np.float32), rank=self.rank[rows],
            joint_index=self.joint_index[rows], joint_weight=self.joint_weight[rows], residual=residual,
        )  # fmt: skip


def read_look(avatar: Avatar, tier: str | None = None, player: str = "page") -> StillLook:
    """The look of an avatar with all Gaussians of its bundle; see `StillLook`.

    tier: one that is linear, None for the best of these that the bundle holds, or for the only look of an avatar that
    has one for all poses. player: what will play it, for notes. Raises WrongValue for another tier, and for a bundle
    whose look moves with the pose and that holds none.
    """
    stored, known = stored_tiers(avatar.bundle), player_tiers()
    linear = [name for name in stored if name in known.having(linear=True)]
    played = sorted(linear, key=lambda name: not known[name].kind.moves) or ([] if avatar.dynamic else stored[:1])
    if tier is not None and tier not in played:
        choices = " or ".join(played) or "no tier"
        raise WrongValue(f"`tier={tier}`: without its networks {choices} of this bundle can be played")
    if not played:
        tiers = ",".join(known.having(linear=True))
        raise WrongValue(
            f"{avatar.bundle.path} holds no tier that plays without its networks: export it again with gavatar-export "
            f"RUN --tiers {tiers}"
        )
    surface, maps = avatar.bundle.surfaces()
    built, pose = build_tier(tier or played[0], Parts(avatar.bundle, surface, maps)), _relaxed(avatar)
    still, residual = cast(LinearTier, built).linear() if linear else (built(pose), None)
    points, colors, scales = (np.array(array) for array in still)
    return StillLook(
        avatar.name, tier or played[0], points, colors, scales, surface.spacing, surface.rank,
        surface.joint_index, surface.joint_weight, avatar.joint_names, surface.parents, surface.joints,
        invert_rigid(surface.A_canonical)[:, :3], pose, avatar.pixel, None if residual is None else dict(residual),
        _left_out(avatar, player),
    )  # fmt: skip


def _relaxed(avatar: Avatar) -> np.ndarray:
    pose = relaxed_pose()[None].astype(np.float32)
    return avatar.fit(Motion(pose, np.zeros((1, 3), np.float32), 1.0))[0].poses[0]


def _left_out(avatar: Avatar, player: str) -> tuple[str, ...]:
    notes = []
    if avatar.expression is not None:
        notes.append(f"the {player} plays no facial expressions: the face keeps its look at rest")
    if POSE_BLENDSHAPES in avatar.bundle.manifest.members:
        notes.append(f"the {player} leaves out the body's pose blendshapes, which move its skin by millimetres")
    return tuple(notes)
