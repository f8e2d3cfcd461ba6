"""What a JPEG image comes out as, with nothing but NumPy: the loss of its quantization alone (ITU T.81, annex A)."""

from __future__ import annotations

import numpy as np

_LUMINANCE = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55,
    14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51, 87, 80, 62,
    18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92,
    49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
]  # fmt: skip
_CORNER = [[17, 18, 24, 47], [18, 21, 26, 66], [24, 26, 56, 99], [47, 66, 99, 99]]
_TO_YCC = np.array([[0.299, 0.587, 0.114], [-0.168735892, -0.331264108, 0.5], [0.5, -0.418687589, -0.081312411]])


def through_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    """(H, W, 3) uint8 -> (H, W, 3) float64 in [0, 255], not rounded."""
    height, width, _ = image.shape
    padded = np.pad(image, ((0, -height % 8), (0, -width % 8), (0, 0)), mode="edge")
    planes = padded.astype(float) @ _TO_YCC.T - np.array([128, 0, 0])
    k, x = np.mgrid[:8, :8]
    dct = np.where(k == 0, np.sqrt(1 / 8), 0.5) * np.cos((2 * x + 1) * k * np.pi / 16)
    rows, columns = padded.shape[0] // 8, padded.shape[1] // 8
    blocks = planes.reshape(rows, 8, columns, 8, 3).transpose(0, 2, 4, 1, 3)
    steps = _steps(quality)
    kept = np.rint(dct @ blocks @ dct.T / steps) * steps
    planes = (dct.T @ kept @ dct).transpose(0, 3, 1, 4, 2).reshape(padded.shape)
    stored = np.clip(planes + 128, 0, 255)  # as decoders hold them
    colors = (stored - np.array([0, 128, 128])) @ np.linalg.inv(_TO_YCC).T
    return np.clip(colors, 0, 255)[:height, :width]


def _steps(quality: int) -> np.ndarray:
    """(3, 8, 8) of Y, Cb and Cr."""
    color = np.full((8, 8), 99)
    color[:4, :4] = _CORNER
    base = np.stack([np.reshape(_LUMINANCE, (8, 8)), color, color])
    percent = 5000 // quality if quality < 50 else 200 - 2 * quality
    return np.clip((base * percent + 50) // 100, 1, 255)
