"""Gaussians as the .ply of 3D Gaussian Splatting, which most programs for splats read."""

from __future__ import annotations

import numpy as np

from ...values.gaussians import Gaussians
from .gaussian_files import GaussianFiles
from .output import OUTPUTS

FIELDS = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
HARMONIC = 0.28209479177387814  # the spherical harmonic of degree 0, 1 / (2 sqrt(pi))
# The format stores logit and logarithm, which are infinite at the ends: clamped to what no pixel of 8 bits shows.
OPACITY_EDGE = 1e-6  # from 0 and from 1
SMALLEST = 1e-6  # metres


@OUTPUTS.register("ply", summary="Gaussians as the .ply of 3D Gaussian Splatting, or one a frame: NAME/%06d.ply")
class PlyFile(GaussianFiles):
    """Binary, little endian, float32, spherical harmonics of degree 0, in the order of the authors' own files (Kerbl et
    al. 2023, `save_ply`), some of whose readers go by it.

    Metres; y points down, as in the scenes that 3DGS learns: our world (y up) after half a turn about z, which viewers
    that stand such files upright (PlayCanvas, SuperSplat) turn back.
    f_dc: colour = 0.5 + HARMONIC f_dc. opacity: its logit, within OPACITY_EDGE of 0 and 1. scale: the logarithm of the
    standard deviation, at least SMALLEST, thrice the same where Gaussians are round. rot: wxyz. Normals are zero.
    """

    suffixes = (".ply", "%d.ply")

    def encode(self, gaussians: Gaussians) -> bytes:
        count = len(gaussians)
        table = np.zeros((count, len(FIELDS)), "<f4")
        table[:, 0:3] = gaussians.means * (-1, -1, 1)
        table[:, 6:9] = (gaussians.colors - 0.5) / HARMONIC
        table[:, 9] = _logit(np.ones(count) if gaussians.opacities is None else gaussians.opacities)
        scales = gaussians.scales[:, None] if gaussians.scales.ndim == 1 else gaussians.scales
        table[:, 10:13] = np.log(np.maximum(scales, SMALLEST))
        table[:, 13:17] = _turned(gaussians.quaternions) if gaussians.quaternions is not None else (1, 0, 0, 0)
        return _header(count) + table.tobytes()


def _logit(opacities: np.ndarray) -> np.ndarray:
    inner = np.clip(np.asarray(opacities, np.float64), OPACITY_EDGE, 1 - OPACITY_EDGE)
    return np.log(inner / (1 - inner))


def _turned(quaternions: np.ndarray) -> np.ndarray:
    """(N, 4) wxyz, after half a turn about z: the product k q. (Round or axis-aligned Gaussians look the same.)"""
    w, x, y, z = quaternions.T
    return np.stack([-z, -y, x, w], -1)


def _header(count: int) -> bytes:
    """No comment in it: the authors' own viewer expects the number of vertices on the third line."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property float {name}" for name in FIELDS]
    return "\n".join([*lines, "end_header", ""]).encode("ascii")
