"""What a decoder says of each surface point, and the contract of decoders and encoders."""

from __future__ import annotations

import dataclasses
from typing import Protocol

from torch import Tensor


@dataclasses.dataclass
class Attributes:
    """Per-point output of a decoder, in the canonical pose.

    offsets: (..., N, 3) metres from the surface point. colors: (..., N, 3) in [0, 1]. scales: (..., N) metres, >= 0, or
    (..., N, 3) along the axes of `rotations`. rotations: (..., N, 4) wxyz, of unit length, None where Gaussians are
    isotropic.
    """

    offsets: Tensor
    colors: Tensor
    scales: Tensor
    rotations: Tensor | None = None


class Decoder(Protocol):
    """A component of the `decoder` registry: an nn.Module built as `factory(config, in_channels=C)`.

    `forward(features (P, C), uv (P, 2), spacing (P,)) -> Attributes` of P points. `spacing` is the distance in metres
    between neighbouring points, the natural unit of a Gaussian's scale. Everything must be exportable to ONNX. One
    whose traits say `counts_steps` has `on_step(step)` too, which is called before each training step of stage 1.
    """

    def __call__(self, features: Tensor, uv: Tensor, spacing: Tensor) -> Attributes: ...


class Encoder(Protocol):
    """A component of the `encoder` registry: an nn.Module built as `factory(config, channels=C, map_size=None)`,
    or None for a static avatar. `map_size` is the side of the maps it wants.

    `forward(*inputs) -> (B, C, M, M)` pose features, added to the learnable features. The inputs are those that its
    traits declare, of B poses. One whose traits say `prepares` has `prepare(surface, seen, *inputs)` too, which is
    called once before its first training step with the sampled surface of the maps, the texels that each training view
    shows, (V, M, M) bool, and the inputs in all of these views; what it keeps belongs into buffers.
    """

    map_size: int

    def __call__(self, *inputs: Tensor) -> Tensor: ...
