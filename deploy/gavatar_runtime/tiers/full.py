"""The tier `full`: the networks as they were trained, in float32; and `int8`, the decoder in 8-bit arithmetic."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from ..bundle import SURFACE
from ..components import NoOptions
from ..decoding.network import OPEN, Network
from ..decoding.pose_inputs import PoseInput, check_inputs, input_shape
from ..decoding.residuals import Attributes, empty
from ..errors import UserError
from ..values.array_rules import ADVICE
from . import PLAYER_TIERS, Parts
from .members import DECODER, DECODER_INT8, ENCODER, ENCODER_INT8, OUTPUTS, POSE_FEATURES


class Encoder:
    """The pose features (1, C, M, M) of a pose, from whichever of `pose_inputs.INPUTS` the member asks for, in an array
    that the next call fills again."""

    def __init__(self, parts: Parts, member: str):
        self._network = Network(parts.bundle, member, None, (POSE_FEATURES,), parts.threads)
        self._network.check_shape(POSE_FEATURES, (1, None, None, None))
        surface, self._source = parts.map_surface, f"{parts.bundle.path}: {member}"
        check_inputs(self._network.inputs, self._source)
        if surface is None:
            raise UserError(f"{self._source} wants a map of the body, and {SURFACE} has none; {ADVICE}")
        for name in self._network.inputs:
            self._network.check_shape(name, (1, *input_shape(name, surface.resolution)))
        if "normal_map" in self._network.inputs and not np.isfinite(surface.normals).all():
            raise UserError(f"{self._source} wants a normal_map, and {SURFACE} lacks the array 'map_normals'; {ADVICE}")
        self._inputs = [PoseInput(name, surface) for name in self._network.inputs]
        self._features: np.ndarray | None = None

    def __call__(self, pose: np.ndarray) -> np.ndarray:
        inputs = [made(pose) for made in self._inputs]
        if self._features is None:
            (self._features,) = self._network(*inputs)
            if not np.isfinite(self._features).all():
                raise UserError(f"{self._source} gives NaN or infinite '{POSE_FEATURES}'; {ADVICE}")
        else:
            self._network(*inputs, out=(self._features,))
        return self._features


def decoder_network(parts: Parts, member: str, inputs: tuple[str, ...], *, by_rows: bool) -> Network:
    """A decoder whose declared outputs are `OUTPUTS`, of as many rows as are asked for where it `picks`."""
    network = Network(parts.bundle, member, inputs, OUTPUTS, parts.threads, by_rows=by_rows)
    rows = OPEN if network.picks else None
    for name, rest in zip(OUTPUTS, ((3,), (3,), ()), strict=True):
        network.check_shape(name, (rows, *rest))
    return network


@PLAYER_TIERS.register("full", summary="the networks as trained, float32", default=True)
class Full:
    """Encoder, then decoder on every Gaussian, or on the rows asked for."""

    encoder, decoder = ENCODER, DECODER
    members: tuple[str, ...] = (ENCODER, DECODER)
    networks, picks = True, True

    def __init__(self, options: NoOptions, *, parts: Parts):
        self._parts = parts
        self.moves = parts.bundle.manifest.dynamic
        self.stage_seconds: dict[str, float] = {}
        self._encoder = Encoder(parts, self.encoder) if self.moves else None
        inputs = (POSE_FEATURES,) if self.moves else ()
        self._decoder = decoder_network(parts, self.decoder, inputs, by_rows=self.moves)
        self.picks = self._decoder.picks
        chosen = parts.chosen
        if chosen is None and self.picks:
            chosen = np.arange(len(parts.surface))  # named all the same, so that threads can share them
        self._chosen = None if chosen is None else chosen.astype(np.int32)
        self._points = parts.take(parts.surface.points)
        self._out = [empty(len(parts)) for _ in range(3)]
        # bundles written before `rows` decode all that they hold, and then some are taken
        self._decoded = empty(len(parts) if self.picks or self._chosen is None else len(parts.surface))
        self._checked = False
        self._calls = 0

    def __call__(self, pose: np.ndarray, rows: np.ndarray | None = None) -> Attributes:
        start = perf_counter()
        features = () if self._encoder is None else (self._encoder(pose),)
        encoded = perf_counter()
        self._calls += 1
        points, colors, scales = self._out[self._calls % 3]
        if rows is not None:
            points, colors, scales = points[: len(rows)], colors[: len(rows)], scales[: len(rows)]
        out = points, colors, scales
        if self.picks:
            wanted = self._chosen if rows is None or self._chosen is None else self._chosen[rows]
            offsets = self._decoded[0][: len(scales)]
            self._run(features, wanted, (offsets, colors, scales))
        else:
            self._run(features, None, self._decoded)
            offsets = self._taken(out)
        np.add(self._points if rows is None else self._points[rows], offsets, out=points)
        if self._parts.added is not None:
            added = self._parts.added if rows is None else self._parts.added[rows]
            np.sqrt(np.add(np.square(scales, out=scales), added, out=scales), out=scales)  # `detail.grown`, in place
        self.stage_seconds = {"encode": encoded - start, "decode": perf_counter() - encoded}
        return out

    def _run(self, features: tuple, rows: np.ndarray | None, out: Attributes) -> None:
        if self._checked:
            self._decoder(*features, rows=rows, out=out)
            return
        offsets, colors, scales = self._decoder(*features, rows=rows)
        decoded = self._parts.check((offsets, colors, scales), self.decoder, len(out[2]))
        for target, array in zip(out, decoded, strict=True):
            target[...] = array
        self._checked = True

    def _taken(self, out: Attributes) -> np.ndarray:
        """Fill colours and scales of `out` from what was decoded in full, and return the offsets."""
        offsets, *rest = self._decoded
        if self._chosen is None:
            for target, array in zip(out[1:], rest, strict=True):
                np.copyto(target, array)
            return offsets
        for target, array in zip(out, self._decoded, strict=True):
            np.take(array, self._chosen, 0, out=target, mode="clip")
        return out[0]


@PLAYER_TIERS.register("int8", summary="the decoder in 8-bit arithmetic, calibrated on the capture's poses")
class Int8(Full):
    """As `full`, by the quantised members."""

    encoder, decoder = ENCODER_INT8, DECODER_INT8
    members: tuple[str, ...] = (ENCODER_INT8, DECODER_INT8)
