"""Gaussians as .splat: 32 bytes each and nothing else, the simplest of the formats that web viewers read."""

from __future__ import annotations

import numpy as np

from ...values.gaussians import Gaussians
from .gaussian_files import GaussianFileOptions, GaussianFiles
from .output import OUTPUTS
from .splat_values import SMALLEST, axes, opacities, turned_y_down, unit_quaternions, y_down

RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])


@OUTPUTS.register(
    "splat",
    config=GaussianFileOptions,
    summary="Gaussians as .splat, 32 bytes each, or one file a frame: NAME/%06d.splat",
)
class SplatFile(GaussianFiles):
    """Little endian, without a header, as antimatter15/splat reads it.

    Metres; y points down (`splat_values.y_down`). scale: the standard deviation, at least SMALLEST, since readers take
    its logarithm. color: sRGB and opacity in 255ths; colours beyond the display are clamped. rotation: wxyz, each as
    128 (1 + q), so that zero has a byte of its own; the rotations of round Gaussians are the identity.
    """

    suffixes = (".splat", "%d.splat")

    def encode(self, gaussians: Gaussians) -> bytes:
        table = np.zeros(len(gaussians), RECORD)
        table["position"] = y_down(gaussians.means)
        table["scale"] = np.maximum(axes(gaussians), SMALLEST)
        table["color"] = to_byte(np.column_stack([gaussians.colors, opacities(gaussians)]) * 255)
        q = unit_quaternions(gaussians)
        table["rotation"] = to_byte(128 * (1 + (q if gaussians.quaternions is None else turned_y_down(q))))
        return table.tobytes()


def to_byte(values: np.ndarray) -> np.ndarray:
    """The nearest whole numbers of [0, 255], uint8."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
