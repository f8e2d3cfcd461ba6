"""What each tier reads of a bundle: the file names of its members and the arrays in them, for those who write them and
those who read them alike.

N Gaussians, M coarse points, P body parts, J joints that are looked at, K bases of each part, F filmed poses.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping

import numpy as np

from ..bundle import DECODER, ENCODER, pack_arrays
from ..values.array_rules import FAR, Rule, ascending, checked, lacking, sums_to_one
from ..values.body import SMPL_BODY_JOINTS

__all__ = [
    "BAKED", "BLENDSHAPE", "COARSE", "DECODER", "DECODER_COARSE", "DECODER_INT8", "ENCODER", "ENCODER_INT8", "OUTPUTS",
    "POSE_FEATURES", "ArrayMember", "Rule",
]  # fmt: skip

# networks: ENCODER and DECODER are those without which a bundle of a moving avatar does not play
ENCODER_INT8, DECODER_INT8 = "encoder_int8.onnx", "decoder_int8.onnx"
DECODER_COARSE = "decoder_coarse.onnx"
POSE_FEATURES = "pose_features"  # what encoders give and decoders take, (1, C, M, M)
OUTPUTS = ("offsets", "colors", "scales")  # of decoders: (N, 3) metres, (N, 3) in [0, 1], (N,) metres


@dataclasses.dataclass(frozen=True)
class ArrayMember:
    """An .npz of a bundle. file: its name. arrays: that it always has. others: patterns of names that it may have.

    Either is a table of `Rule`s by name, which `Parts.arrays` holds a bundle's arrays to when it is opened; these may
    count on the sizes N, of all Gaussians of the bundle, and `body_joints`. Names alone are only looked for.
    """

    file: str
    arrays: Mapping[str, Rule] | tuple[str, ...]
    others: Mapping[str, Rule] | tuple[str, ...] = ()

    def pack(self, arrays: Mapping[str, np.ndarray]) -> bytes:
        """The member's bytes; ValueError for an array that is missing, or that no reader knows."""
        missing = [name for name in self.arrays if name not in arrays]
        unknown = [n for n in arrays if n not in self.arrays and not any(re.fullmatch(o, n) for o in self.others)]
        if missing or unknown:
            raise ValueError(f"{self.file}: arrays {missing} are missing, arrays {unknown} are unknown")
        return pack_arrays(arrays)

    def read(self, arrays: Mapping[str, np.ndarray], source: str, sizes: Mapping[str, int]) -> dict[str, np.ndarray]:
        """The arrays by name, checked; UserError naming `source` and the array that breaks its rule."""
        for name in self.arrays:
            if name not in arrays:
                raise lacking(source, name)
        rules = dict(self.arrays) if isinstance(self.arrays, Mapping) else {}
        if isinstance(self.others, Mapping):
            rules |= {name: dataclasses.replace(rule, optional=True) for name, rule in self.others.items()}
        return {**arrays, **checked(arrays, rules, source, sizes=sizes)}


# the mean over the capture's poses, written as float16
BAKED = ArrayMember(
    "baked.npz",
    {
        "offsets": Rule(("N", 3), low=-FAR, high=FAR),
        "colors": Rule(("N", 3)),
        "scales": Rule(("N",), low=0, high=FAR),
    },
)

# index and weight of the coarse points about each Gaussian; base, the coarse points' mean offset, colour and scale,
# which residuals are taken from; ratio of fine to coarse spacing, by which residuals of the scale shrink
COARSE = ArrayMember(
    "coarse.npz",
    {
        "base": Rule(("M", 7)),
        "index": Rule(("N", 4), np.int32, below="M"),
        "weight": Rule(("N", 4), tests=(sums_to_one(1e-2),)),  # float16: four roundings by 2.4e-4 at most
        "ratio": Rule((), low=0),
    },
)

# part of each Gaussian; basis (`decoding.residuals.grouped`), in units of gains; low and high, between which
# coefficients are clamped; joints whose rotations are looked at; input_low and input_high, between which these are
# clamped. G = K / 4 groups of bases.
# weight_0, bias_0, weight_1, ...: layers from the inputs to the coefficients, with ReLU between them.
# owners, direct, turn: of a look that depends on where surfaces face, what is linear in the inputs and in
# `blendshape.turn_input`.
# seen, near, fade: filmed poses, the joints that bend each part, and the distances from the nearest filmed pose between
# which a part loses its residual.
BLENDSHAPE = ArrayMember(
    "blendshape.npz",
    {
        "gains": Rule(("P", 8), np.floating),
        "part": Rule(("N",), np.uint8, below="P"),
        "basis": Rule(("N", "G", 8, 4), np.int8),
        "low": Rule(("P G 4",), np.floating),
        "high": Rule(("P G 4",), np.floating),
        "joints": Rule(("J",), np.integer, below="body_joints"),
        "input_low": Rule(("9 J",), np.floating),
        "input_high": Rule(("9 J",), np.floating),
    },
    {
        r"weight_\d+": Rule(("?", "?"), np.floating),
        r"bias_\d+": Rule(("?",), np.floating),
        "owners": Rule(("P",), np.integer, high=SMPL_BODY_JOINTS - 1, below="body_joints", beside=("turn", "direct")),
        "direct": Rule(("9 J", "P G 4"), np.floating, beside=("turn", "owners")),
        "turn": Rule(("P", 55, "G 4"), np.floating, beside=("owners", "direct")),
        "seen": Rule(("F", "9 J"), beside=("near", "fade")),
        "near": Rule(("P", "J"), np.bool_, beside=("seen", "fade")),
        "fade": Rule((2,), np.floating, low=0, tests=(ascending,), beside=("seen", "near")),
    },
)
