"""The Gaussians that every half of gavatar speaks of."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True, eq=False)
class Gaussians:
    """N Gaussians in the world. Arrays are NumPy in the player and torch tensors in training, all of one dtype.

    means: (N, 3) metres. scales: (N,) standard deviation in metres, or (N, 3) along the axes of `quaternions`.
    colors: (N, 3) display-referred sRGB in [0, 1]. opacities: (N,) in [0, 1]; absent means 1.
    quaternions: (N, 4) wxyz; absent means the identity. normals: (N, 3) in the world, of length 1 or less; no
    part of the picture, only a hint for rasterizers that can leave out what faces away.
    """

    means: Any
    scales: Any
    colors: Any
    opacities: Any = None
    quaternions: Any = None
    normals: Any = None

    def __len__(self) -> int:
        return len(self.means)

    def copied(self) -> Gaussians:
        """The same Gaussians in NumPy arrays of their own."""
        arrays = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return Gaussians(**{name: None if a is None else np.array(a) for name, a in arrays.items()})


@dataclasses.dataclass(frozen=True, eq=False)
class Rendering:
    """What a rasterizer returns, arrays of the same kind as the Gaussians.

    color: (H, W, 3) composited over the background. alpha: (H, W) = 1 - final transmittance.
    depth: (H, W) sum of weight x camera z, metres (not divided by alpha).
    dropped: Gaussians ignored because a field was NaN or infinite.
    """

    color: Any
    alpha: Any
    depth: Any
    dropped: int = 0
