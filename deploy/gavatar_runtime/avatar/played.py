"""What the player asks of an avatar, whichever way it decodes."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..bundle import Bundle
from ..values.camera import Camera
from ..values.gaussians import Gaussians
from ..values.motion import Motion
from ..values.point_evidence import Evidence
from ..values.surface import Surface
from .expression import Expression


class PlayedAvatar(Protocol):
    """An avatar that can be posed frame by frame: `Avatar` at one level of detail, `AdaptiveAvatar` at one after
    another, where these fields are those of its finest level.

    bundle: where it came from. name: of the person. tier: how its Gaussians are decoded. surface: where its N
    Gaussians sit, at its level of detail. joint_names: of the body, J names.
    joints: (J, 3) rest joints of its shape, metres. expression: what expressions do to a body that has a face, or None.
    evidence: how much of each Gaussian training saw, None in bundles that do not say.
    pixel: metres of the person that a pixel of the training images spanned, None where that is not known.
    stage_seconds: what the last call of `gaussians` spent on `encode`, `decode` and `skin`.
    """

    bundle: Bundle
    name: str
    tier: str | None
    surface: Surface
    joint_names: tuple[str, ...]
    joints: np.ndarray
    expression: Expression | None
    evidence: Evidence | None
    pixel: float | None
    stage_seconds: dict[str, float]

    def __len__(self) -> int:
        """N, the number of Gaussians."""
        return len(self.surface)

    def fit(self, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
        """The motion brought to this body's joints, and the names of what moves in it that the body lacks."""
        raise NotImplementedError

    def follow(self, motion: Motion | None) -> None:
        """Prepare for the poses of a fitted motion, None for any."""
        raise NotImplementedError

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
        """The avatar in one pose; without `copy`, in arrays that the third call from this one fills again."""
        raise NotImplementedError

    def frame_took(self, seconds: float) -> None:
        """Told after each frame how long it was in coming; of no concern where the level of detail is fixed."""
        return None
