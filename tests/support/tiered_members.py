"""A bundle of a moving avatar with all tiers, made by hand of a few Gaussians, so that its arrays can be spoilt."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
from make_bundle import decoder, manifest, members

from gavatar_runtime.bundle import pack_arrays, write_bundle
from gavatar_runtime.formats.bounded import arrays_of_npz
from gavatar_runtime.tiers.members import BAKED, BLENDSHAPE, COARSE, DECODER_COARSE

COUNT, COARSE_COUNT, PARTS, LOOKED_AT = 60, 10, 2, 3


def tier_arrays() -> dict[str, dict[str, np.ndarray]]:
    """The arrays of each .npz that cheaper tiers read, all that there may be."""
    rng = np.random.default_rng(0)
    inputs, outputs, wide = 9 * LOOKED_AT, 4 * PARTS, 5
    f16, f32 = np.float16, np.float32
    return {
        BAKED.file: {
            "offsets": rng.normal(0, 0.01, (COUNT, 3)).astype(f16),
            "colors": rng.random((COUNT, 3)).astype(f16),
            "scales": np.full(COUNT, 0.01, f16),
        },
        COARSE.file: {
            "index": rng.integers(0, COARSE_COUNT, (COUNT, 4)).astype(np.uint16),
            "weight": np.full((COUNT, 4), 0.25, f16),
            "base": rng.random((COARSE_COUNT, 7)).astype(f32),
            "ratio": f32(0.5),
        },
        BLENDSHAPE.file: {
            "part": rng.integers(0, PARTS, COUNT).astype(np.uint8),
            "basis": rng.integers(-9, 9, (COUNT, 1, 8, 4)).astype(np.int8),
            "gains": np.full((PARTS, 8), 1e-4, f32),
            "low": np.full(outputs, -1, f32),
            "high": np.ones(outputs, f32),
            "joints": np.arange(1, 1 + LOOKED_AT),
            "input_low": np.full(inputs, -2, f32),
            "input_high": np.full(inputs, 2, f32),
            "weight_0": rng.normal(0, 0.1, (inputs, wide)).astype(f32),
            "bias_0": np.zeros(wide, f32),
            "weight_1": rng.normal(0, 0.1, (wide, outputs)).astype(f32),
            "bias_1": np.zeros(outputs, f32),
            "owners": np.arange(PARTS, dtype=np.uint8),
            "direct": np.zeros((inputs, outputs), f32),
            "turn": np.zeros((PARTS, 55, 4), f32),
            "seen": np.zeros((2, inputs), f16),
            "near": np.ones((PARTS, LOOKED_AT), bool),
            "fade": np.array([0.5, 1.0], f32),
        },
    }


@functools.cache
def all_members() -> dict[str, bytes]:
    """The members of the bundle by file name."""
    made = members(COUNT, dynamic=True) | {name: pack_arrays(arrays) for name, arrays in tier_arrays().items()}
    return made | {DECODER_COARSE: decoder(np.full((COARSE_COUNT, 3), 0.5), dynamic=True)}


def member_arrays() -> dict[str, dict[str, np.ndarray]]:
    """The arrays of every .npz by file name."""
    return {name: arrays_of_npz(data) for name, data in all_members().items() if name.endswith(".npz")}


def write_tiered(path: Path, changed: dict[str, bytes] | None = None) -> Path:
    """The bundle with some members replaced."""
    said = dataclasses.replace(
        manifest(COUNT, dynamic=True), tiers=[{"name": name} for name in ("baked", "coarse", "blendshape")]
    )
    write_bundle(path, said, all_members() | (changed or {}))
    return path
