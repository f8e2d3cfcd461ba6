"""Gaussians as .spz, Niantic's compressed format: a gzip stream of about a fifth of the .ply's size."""

from __future__ import annotations

import gzip
import struct

import numpy as np

from ...errors import UserError
from ...values.gaussians import Gaussians
from .gaussian_files import GaussianFileOptions, GaussianFiles
from .output import OUTPUTS
from .splat import to_byte
from .splat_values import harmonics, largest_dropped, log_axes, opacities, unit_quaternions

MAGIC, VERSION = 0x5053474E, 3  # the last version that is one gzip stream, and the most widely read
FRACTION = 12  # bits of a position below one metre: a quarter of a millimetre
PLACES = 24  # bits of a position
MOST_OPAQUE = 254  # of 255 readers take the logit, which is infinite, and write that into a .ply
COLOR_SCALE = 0.15  # bytes hold colours from -0.44 to 1.44


@OUTPUTS.register(
    "spz", config=GaussianFileOptions, summary="Gaussians as .spz of Niantic (version 3), or one a frame: NAME/%06d.spz"
)
class SpzFile(GaussianFiles):
    """Version 3, spherical harmonics of degree 0. A 16-byte header, then one array after another.

    Metres; y points up, x right and z to the viewer ("RUB"), as our world has them. Positions: 24-bit fixed point with
    FRACTION bits below the point, fewer where somebody is farther away than 2 km. Opacity: in 255ths, linear,
    MOST_OPAQUE at the most. Colours: coefficients of degree 0 times COLOR_SCALE, in 255ths, about one half. Scales:
    sixteenths of the natural logarithm from -10 on: 45 micrometres at the least. Rotations: xyzw, the largest dropped,
    the others with a sign and 9 bits.
    """

    suffixes = (".spz", "%d.spz")

    def encode(self, gaussians: Gaussians) -> bytes:
        farthest = float(np.abs(gaussians.means).max(initial=0))
        room = (1 << (PLACES - 1)) - 1
        fraction = next((bits for bits in range(FRACTION, -1, -1) if np.rint(farthest * 2.0**bits) <= room), None)
        if fraction is None:
            raise UserError(f"{self.path}: a Gaussian is {farthest:.3g} m away, and .spz holds {room} m: write a .ply")
        header = struct.pack("<3I4B", MAGIC, VERSION, len(gaussians), 0, fraction, 0, 0)
        arrays = (
            _fixed_point(gaussians.means, fraction),
            np.minimum(to_byte(opacities(gaussians) * 255), MOST_OPAQUE),
            to_byte(harmonics(gaussians) * COLOR_SCALE * 255 + 127.5),
            to_byte((log_axes(gaussians) + 10) * 16),
            packed_rotations(unit_quaternions(gaussians)),
        )
        return gzip.compress(header + b"".join(a.tobytes() for a in arrays), 6, mtime=0)


def _fixed_point(means: np.ndarray, fraction: int) -> np.ndarray:
    """(N, 3) -> (N, 3, 3) uint8, the lowest byte first, two's complement."""
    whole = np.rint(np.asarray(means, np.float64) * 2.0**fraction).astype("<i4")
    return np.ascontiguousarray(whole).view(np.uint8).reshape(*means.shape, 4)[..., :3]


def packed_rotations(quaternions: np.ndarray) -> np.ndarray:
    """(N, 4) wxyz -> (N,) uint32, little endian: two bits for the largest of xyzw, ten for each other."""
    largest, others = largest_dropped(quaternions[:, [1, 2, 3, 0]])
    parts = np.rint(np.abs(others) * (511 * np.sqrt(2))).astype(np.uint32)
    packed = largest.astype(np.uint32)
    for part, negative in zip(parts.T, (others < 0).T, strict=True):
        packed = packed << 10 | negative.astype(np.uint32) << 9 | np.minimum(part, 511)
    return packed.astype("<u4")
