"""The Gaussians that every half of gavatar speaks of."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
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


def together(parts: Sequence[Gaussians]) -> Gaussians:
    """All of them as one, in NumPy arrays of its own; a single one is itself.

    What one part has and another lacks is filled in as its absence means it: opacities of 1, quaternions of the
    identity, one scale along each axis. Normals are kept only where all have them. Raises ValueError for none.
    """
    if len(parts) == 1:
        return parts[0]
    scales = [np.asarray(part.scales) for part in parts]
    if len({s.ndim for s in scales}) > 1:
        scales = [s if s.ndim == 2 else np.repeat(s[:, None], 3, 1) for s in scales]
    filled: dict[str, Any] = {"scales": np.concatenate(scales)}
    for name, default in (("opacities", 1.0), ("quaternions", (1.0, 0.0, 0.0, 0.0))):
        arrays = [getattr(part, name) for part in parts]
        if any(array is not None for array in arrays):
            filled[name] = np.concatenate(
                [
                    np.broadcast_to(np.array(default, part.means.dtype), (len(part), *np.shape(default)))
                    if array is None
                    else array
                    for part, array in zip(parts, arrays, strict=True)
                ]
            )
    if all(part.normals is not None for part in parts):
        filled["normals"] = np.concatenate([part.normals for part in parts])
    means, colors = (np.concatenate([getattr(part, name) for part in parts]) for name in ("means", "colors"))
    return Gaussians(means=means, colors=colors, **filled)


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
