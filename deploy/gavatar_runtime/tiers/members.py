"""What each tier reads of a bundle: the file names of its members and the arrays in them, for those who write them and
those who read them alike.

N Gaussians, M coarse points, P body parts, J joints that are looked at, K bases, F filmed poses.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping

import numpy as np

from ..bundle import DECODER, ENCODER, pack_arrays

__all__ = [
    "BAKED", "BLENDSHAPE", "COARSE", "DECODER", "DECODER_COARSE", "DECODER_INT8", "ENCODER", "ENCODER_INT8", "OUTPUTS",
    "POSE_FEATURES", "ArrayMember",
]  # fmt: skip

# networks: ENCODER and DECODER are those without which a bundle of a moving avatar does not play
ENCODER_INT8, DECODER_INT8 = "encoder_int8.onnx", "decoder_int8.onnx"
DECODER_COARSE = "decoder_coarse.onnx"
POSE_FEATURES = "pose_features"  # what encoders give and decoders take, (1, C, M, M)
OUTPUTS = ("offsets", "colors", "scales")  # of decoders: (N, 3) metres, (N, 3) in [0, 1], (N,) metres


@dataclasses.dataclass(frozen=True)
class ArrayMember:
    """An .npz of a bundle. file: its name. arrays: that it always has. others: patterns of names that it may have."""

    file: str
    arrays: tuple[str, ...]
    others: tuple[str, ...] = ()

    def pack(self, arrays: Mapping[str, np.ndarray]) -> bytes:
        """The member's bytes; ValueError for an array that is missing, or that no reader knows."""
        missing = [name for name in self.arrays if name not in arrays]
        unknown = [n for n in arrays if n not in self.arrays and not any(re.fullmatch(o, n) for o in self.others)]
        if missing or unknown:
            raise ValueError(f"{self.file}: arrays {missing} are missing, arrays {unknown} are unknown")
        return pack_arrays(arrays)


# float16: offsets (N, 3), colors (N, 3), scales (N,), the mean over the capture's poses
BAKED = ArrayMember("baked.npz", OUTPUTS)

# index (N, 4) and weight (N, 4) of the coarse points about each Gaussian, weights summing to 1; base (M, 7), the coarse
# points' mean offset, colour and scale, which residuals are taken from; ratio of fine to coarse spacing, by which
# residuals of the scale shrink
COARSE = ArrayMember("coarse.npz", ("index", "weight", "base", "ratio"))

# part (N,) of each Gaussian; basis (N, K / 4, 8, 4) int8 (`decoding.residuals.grouped`), in units of gains (P, 8); low
# and high (P K,), between which coefficients are clamped; joints (J,) whose rotations are looked at; input_low and
# input_high (9 J,), between which these are clamped.
# weight_0, bias_0, weight_1, ...: layers from the inputs to the coefficients, with ReLU between them.
# owners (P,), direct (9 J, P K), turn (P, 55, K): of a look that depends on where surfaces face, what is linear in the
# inputs and in `blendshape.turn_input`.
# seen (F, 9 J), near (P, J), fade (2,): filmed poses, the joints that bend each part, and the distances from the
# nearest filmed pose between which a part loses its residual.
BLENDSHAPE = ArrayMember(
    "blendshape.npz",
    ("part", "basis", "gains", "low", "high", "joints", "input_low", "input_high"),
    (r"(weight|bias)_\d+", "owners|direct|turn", "seen|near|fade"),
)
