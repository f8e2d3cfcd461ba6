"""Builds the tier `int8`: the decoder in 8-bit arithmetic, calibrated on the capture's poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import onnx

from gavatar.export.onnx_graphs import decoder_model, encoder_model
from gavatar.export.quantization import quantized
from gavatar.protocols import TierBuilder, TierSource
from gavatar.registry import TIERS
from gavatar_runtime.decoding.pose_inputs import pose_inputs
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.tiers.members import DECODER_INT8, ENCODER_INT8


@dataclasses.dataclass
class Int8Options:
    """poses: of the capture, and as many mixed ones, that activations are measured with. encoder: quantise it too."""

    poses: int = 6
    encoder: bool = False


@TIERS.register("int8", config=Int8Options, summary="the decoder in 8-bit arithmetic")
class Int8Builder(TierBuilder):
    """decoder_int8.onnx and encoder_int8.onnx. The encoder stays in float32 unless asked for: it is a thirtieth of the
    time at 200,000 Gaussians, and its error is added to every point's."""

    needs = ()

    def __init__(self, options: Int8Options):
        self.options = options

    def build(self, source: TierSource) -> dict[str, bytes]:
        avatar, count = source.avatar, self.options.poses
        chosen = source.train_poses[evenly_spaced(len(source.train_poses), count)]
        poses = np.concatenate([chosen, source.random_poses(count)])

        def decoder(
            rows: onnx.ModelProto, scanned: dict[str, np.ndarray], features: np.ndarray | None
        ) -> onnx.ModelProto:
            def samples() -> Iterator[dict[str, np.ndarray]]:
                for i, pose in enumerate(poses):
                    total = source.features(pose[None])[0].numpy() + (0 if features is None else features[0])
                    texels = np.ascontiguousarray(total.reshape(len(total), -1).T)
                    for chunk in range(i % 3, len(next(iter(scanned.values()))), 3):
                        yield {"texels": texels, **{k: v[chunk] for k, v in scanned.items()}}

            return quantized(rows, samples())

        encoder = encoder_model(avatar, shuffle=self.options.encoder)
        if self.options.encoder:
            names = tuple(avatar.encoder_traits.inputs)
            inputs = pose_inputs(source.surface_at(avatar.encoder.map_size), poses, names)
            rows = ({n: x[i : i + 1] for n, x in zip(names, inputs, strict=True)} for i in range(len(poses)))
            encoder = quantized(encoder, rows, ("Conv",))
        model = decoder_model(avatar, source.surface, decoder)
        return {DECODER_INT8: source.finish(model), ENCODER_INT8: source.finish(encoder)}
