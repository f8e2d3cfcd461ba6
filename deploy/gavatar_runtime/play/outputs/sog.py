"""Gaussians as .sog of PlayCanvas: numbers as pixels of lossless images, in a zip."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np

from ...errors import UserError
from ...formats.webp import LARGEST, lossless_webp
from ...values.gaussians import Gaussians
from .gaussian_files import GaussianFileOptions, GaussianFiles
from .output import OUTPUTS
from .splat import to_byte
from .splat_values import harmonics, largest_dropped, log_axes, opacities, turned_y_down, unit_quaternions, y_down

VERSION = 2
STEPS = 65535  # of a coordinate between the bounds
ENTRIES = 256  # of a codebook
FIRST_TAG = 252  # of the four that say which part of a quaternion is left out
_TIME = (1980, 1, 1, 0, 0, 0)  # the same bytes for the same Gaussians


@OUTPUTS.register(
    "sog",
    config=GaussianFileOptions,
    summary="Gaussians as .sog of PlayCanvas (version 2), or one a frame: NAME/%06d.sog",
)
class SogFile(GaussianFiles):
    """meta.json and five images, a pixel a Gaussian, row by row.

    Metres; y points down (`splat_values.y_down`), as PlayCanvas's own writer has it and its viewers turn it upright.
    Positions: sign(x) ln(1 + |x|) in 16 bits between the bounds of each axis. Scales, logarithms of the standard
    deviation, and colours, harmonics of degree 0: bytes into a codebook of even steps. Rotations: wxyz, the largest
    dropped, the others in 255ths of their range. Opacity: in 255ths, linear.
    """

    suffixes = (".sog", "%d.sog")

    def encode(self, gaussians: Gaussians) -> bytes:
        if len(gaussians) > LARGEST**2:
            raise UserError(f"{self.path}: a .sog holds {LARGEST**2} Gaussians, not {len(gaussians)}")
        low, high, steps = _places(y_down(gaussians.means))
        scales, scale_book = _book(log_axes(gaussians))
        colors, color_book = _book(harmonics(gaussians))
        opacity = to_byte(opacities(gaussians) * 255)
        images = {
            "means_l": steps & 255, "means_u": steps >> 8, "scales": scales, "quats": _rotations(gaussians),
            "sh0": np.column_stack([colors, opacity]),
        }  # fmt: skip
        files = {name: [f"{name}.webp"] for name in ("scales", "quats", "sh0")}
        meta = {
            "version": VERSION,
            "count": len(gaussians),
            "antialias": False,
            "means": {"mins": low, "maxs": high, "files": ["means_l.webp", "means_u.webp"]},
            "scales": {"codebook": scale_book, "files": files["scales"]},
            "quats": {"files": files["quats"]},
            "sh0": {"codebook": color_book, "files": files["sh0"]},
        }
        members = {f"{name}.webp": lossless_webp(_image(values)) for name, values in images.items()}
        return _zipped({"meta.json": json.dumps(meta, allow_nan=False).encode(), **members})


def _places(points: np.ndarray) -> tuple[list[float], list[float], np.ndarray]:
    """Bounds of each axis, of signed logarithms, and (N, 3) uint16 between them."""
    logs = np.sign(points) * np.log1p(np.abs(points.astype(np.float64)))
    low, high = (logs.min(0), logs.max(0)) if len(logs) else (np.zeros(3), np.zeros(3))
    span = np.where(high > low, high - low, 1)
    return low.tolist(), high.tolist(), np.rint((logs - low) / span * STEPS).astype(np.uint16)


def _book(values: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """(N, 3) -> (N, 3) uint8 entries and ENTRIES values in even steps."""
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    book = np.linspace(low, high, ENTRIES)
    return to_byte((values - low) / (high - low if high > low else 1.0) * (ENTRIES - 1)), book.tolist()


def _rotations(gaussians: Gaussians) -> np.ndarray:
    """(N, 4) uint8; the rotations of round Gaussians are the identity."""
    q = unit_quaternions(gaussians)
    largest, others = largest_dropped(q if gaussians.quaternions is None else turned_y_down(q))
    return np.column_stack([to_byte((others * np.sqrt(2) + 1) / 2 * 255), FIRST_TAG + largest]).astype(np.uint8)


def _image(values: np.ndarray) -> np.ndarray:
    """(N, 3 or 4) -> (H, W, 4) uint8, as square as can be, opaque where there is no fourth."""
    width = max(1, int(np.ceil(np.sqrt(len(values)))))
    height = max(1, -(-len(values) // width))
    image = np.full((height * width, 4), 255, np.uint8)
    image[: len(values), : values.shape[1]] = values
    return image.reshape(height, width, 4)


def _zipped(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            info = zipfile.ZipInfo(name, _TIME)
            info.compress_type = zipfile.ZIP_DEFLATED
            file.writestr(info, data)
    return buffer.getvalue()
