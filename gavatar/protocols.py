"""The contracts of components: what a class has to do so that it can be registered, one Protocol a concept.

A class derives from its Protocol, or only has what that has. What it can beyond its contract, it says when it is
registered, by the traits of its registry (`gavatar.registry`). Of the player: `gavatar_runtime.tiers.Tier`,
`gavatar_runtime.render.rasterizers.Rasterizer` and `gavatar_runtime.motions.source.MotionSource`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from torch import Tensor

from gavatar_runtime.errors import Faults
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering
from gavatar_runtime.values.surface import Atlas, Surface

from .attributes import Decoder, Encoder
from .avatar.trainable import Avatar
from .capture.capture import Capture
from .losses import Loss

if TYPE_CHECKING:
    import onnx

Background = Tensor | Sequence[float]  # (3,) in [0, 1]

__all__ = [
    "Background",
    "Body",
    "CaptureReader",
    "Decoder",
    "Encoder",
    "Loss",
    "PointPolicy",
    "Rasterizer",
    "TierBuilder",
    "TierSource",
]


class Body(Protocol):
    """A component of `BODIES`, built as `factory(options)`. data: the body's numbers. license: of these."""

    data: BodyData
    license: str


class PointPolicy(Protocol):
    """A component of `POINTS`, built as `factory(options)`: says where on a body its Gaussians are."""

    def sample(self, body: BodyData, betas: np.ndarray | None, count: int) -> Surface:
        """`count` points of a body of shape `betas`, always the same ones; `gavatar.avatar.points.sample_points` makes
        them of a density. UserError for a number that it cannot give."""
        raise NotImplementedError


class CaptureReader(Protocol):
    """A component of `CAPTURES`, built as `factory(options)`. signs: the files by which people know the layout, for
    messages; '' for one that is no layout."""

    signs: str

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether the folder looks like this layout, told from the names in it."""
        raise NotImplementedError

    def read(self, path: Path, faults: Faults | None = None) -> Capture:
        """Open the capture; UserError when it is malformed, naming file and field, after all faults were collected if
        `faults` does."""
        raise NotImplementedError


class Rasterizer(Protocol):
    """A component of `RASTERIZERS`, built as `factory(options)`: draws Gaussians of torch tensors."""

    @property
    def wants_normals(self) -> bool:
        """Whether `Gaussians.normals` would be of use: an avatar computes them only then."""
        return False

    def __call__(self, gaussians: Gaussians, camera: Camera, background: Background = (1.0, 1.0, 1.0)) -> Rendering:
        """The frame, as `gavatar_runtime.splatting_rule` says, in tensors of the Gaussians' dtype and device.
        The fields of the Gaussians are of one floating dtype on one device. background: (3,) in [0, 1]. UserError for
        tensors that it does not draw."""
        raise NotImplementedError


class TierSource(Protocol):
    """A trained avatar with dynamics, as builders of tiers see it. progress: whether to show bars."""

    progress: bool

    @property
    def avatar(self) -> Avatar:
        """In eval mode, on the points of the bundle."""
        raise NotImplementedError

    @property
    def surface(self) -> Surface:
        """These N points."""
        raise NotImplementedError

    @property
    def train_poses(self) -> np.ndarray:
        """(F, J, 3) refined poses of the training frames."""
        raise NotImplementedError

    @property
    def mean_poses(self) -> np.ndarray:
        """Those of them that the still look is the mean of."""
        raise NotImplementedError

    def surface_at(self, uv: int) -> Atlas:
        """The body sampled at uv x uv texels of its atlas."""
        raise NotImplementedError

    def features(self, poses: np.ndarray) -> Tensor:
        """(B, C, M, M) pose features of poses (B, J, 3)."""
        raise NotImplementedError

    def decode(self, pose: np.ndarray, surface: Surface) -> np.ndarray:
        """(N, 7) float32 offset, colour and scale of one pose (J, 3) on the points of `surface`."""
        raise NotImplementedError

    def mean(self, surface: Surface) -> np.ndarray:
        """(N, 7) float32 mean of `decode` over `mean_poses`."""
        raise NotImplementedError

    def random_poses(self, count: int, seed: int = 0) -> np.ndarray:
        """(count, J, 3) plausible poses beyond the capture's, mixed from its own."""
        raise NotImplementedError

    def wide_poses(self, count: int, seed: int = 0) -> np.ndarray:
        """(count, J, 3) poses over a body's range of motion, filmed or not."""
        raise NotImplementedError

    def finish(self, model: onnx.ModelProto) -> bytes:
        """A network as a bundle's member, with its metadata."""
        raise NotImplementedError


class TierBuilder(Protocol):
    """A component of `TIERS`, built as `factory(options)`: makes what the player's tier of the same name reads. needs:
    names of tiers whose members this one also reads."""

    needs: tuple[str, ...]

    def build(self, source: TierSource) -> dict[str, bytes]:
        """The tier's own members by file name."""
        raise NotImplementedError
