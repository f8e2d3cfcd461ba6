"""Gaussians made up for tests of file formats, and what files of others' programs say in the terms of ours."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from plyfile import PlyData

from gavatar_runtime.geometry.rotations import matrix_from_quaternion
from gavatar_runtime.values.gaussians import Gaussians

HALF_TURN_Z = np.diag([-1.0, -1.0, 1.0])  # from y up to y down
HALF_TURN_X = np.diag([1.0, -1.0, -1.0])  # the other way to do that
C0 = 0.5 / np.sqrt(np.pi)  # the spherical harmonic of degree 0


def some(count: int = 7, seed: int = 0, dtype=np.float32, **fields) -> Gaussians:
    rng = np.random.default_rng(seed)
    values = {
        "means": rng.normal(0, 1, (count, 3)),
        "scales": rng.uniform(0.001, 0.1, count),
        "colors": rng.uniform(0, 1, (count, 3)),
    } | fields
    return Gaussians(**{name: None if v is None else np.asarray(v).astype(dtype) for name, v in values.items()})


def long_ones(count: int = 40, seed: int = 1, **fields) -> Gaussians:
    """Of three different scales, turned anyhow, translucent."""
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(0, 1, (count, 4))
    values = {
        "scales": rng.uniform(0.001, 0.1, (count, 3)),
        "quaternions": quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        "opacities": rng.uniform(0.02, 0.98, count),
    }
    return some(count, seed, **{**values, **fields})


@dataclasses.dataclass
class Read:
    """float64, in our world: means (N, 3), scales (N, 3), colors (N, 3), opacities (N,), rotations (N, 3, 3)."""

    means: np.ndarray
    scales: np.ndarray
    colors: np.ndarray
    opacities: np.ndarray
    rotations: np.ndarray

    def turned(self, turn: np.ndarray) -> Read:
        """In a world that is turned (3, 3) against that of the file."""
        return dataclasses.replace(self, means=self.means @ turn.T, rotations=turn @ self.rotations)


def from_stored(means, log_scales, harmonics, logits, quaternions) -> Read:
    """From the numbers of a .ply of 3DGS, with its own activations; nothing is turned."""
    means, log_scales, harmonics, logits = (np.asarray(a, np.float64) for a in (means, log_scales, harmonics, logits))
    rotations = matrix_from_quaternion(np.asarray(quaternions, np.float64))
    with np.errstate(over="ignore"):
        opacities = 1 / (1 + np.exp(-logits.reshape(-1)))
    return Read(means, np.exp(log_scales), 0.5 + C0 * harmonics, opacities, rotations)


def read_ply(path: Path) -> Read:
    """By plyfile; nothing is turned."""
    vertices = PlyData.read(str(path))["vertex"]

    def columns(*names: str) -> np.ndarray:
        return np.stack([np.asarray(vertices[name], np.float64) for name in names], -1)

    return from_stored(
        columns("x", "y", "z"), columns("scale_0", "scale_1", "scale_2"), columns("f_dc_0", "f_dc_1", "f_dc_2"),
        columns("opacity"), columns("rot_0", "rot_1", "rot_2", "rot_3"),
    )  # fmt: skip


def covariances(scales: np.ndarray, rotations: np.ndarray | None = None) -> np.ndarray:
    """(N, 3, 3) of Gaussians with (N,) or (N, 3) scales."""
    scales = np.asarray(scales, np.float64)
    scales = np.repeat(scales[:, None], 3, 1) if scales.ndim == 1 else scales
    L = scales[:, None, :] * (np.eye(3) if rotations is None else rotations)
    return L @ np.swapaxes(L, 1, 2)
