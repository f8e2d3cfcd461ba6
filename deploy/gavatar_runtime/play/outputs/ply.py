"""Gaussians as the .ply of 3D Gaussian Splatting, which most programs for splats read."""

from __future__ import annotations

import numpy as np

from ...values.gaussians import Gaussians
from .gaussian_files import GaussianFileOptions, GaussianFiles
from .output import OUTPUTS
from .splat_values import harmonics, log_axes, logit, opacities, turned_y_down, y_down

FIELDS = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)


@OUTPUTS.register(
    "ply",
    config=GaussianFileOptions,
    summary="Gaussians as the .ply of 3D Gaussian Splatting, or one a frame: NAME/%06d.ply",
)
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
        table[:, 0:3] = y_down(gaussians.means)
        table[:, 6:9] = harmonics(gaussians)
        table[:, 9] = logit(opacities(gaussians))
        table[:, 10:13] = log_axes(gaussians)
        table[:, 13:17] = (1, 0, 0, 0) if gaussians.quaternions is None else turned_y_down(gaussians.quaternions)
        return _header(count) + table.tobytes()


def _header(count: int) -> bytes:
    """No comment in it: the authors' own viewer expects the number of vertices on the third line."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property float {name}" for name in FIELDS]
    return "\n".join([*lines, "end_header", ""]).encode("ascii")
