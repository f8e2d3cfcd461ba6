"""Points of hands that a user has found with a program of their own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gavatar_runtime.errors import UserError

from .landmarks import LENGTH, SIDES, HandLandmarks

WHOLE_BODY = 133  # points of COCO-WholeBody, whose hands begin at these two
_BEGIN = (91, 112)


def read_hands(path: Path, arrays: Mapping[str, np.ndarray], scale: np.ndarray) -> HandLandmarks | None:
    """Hands among the arrays of a landmarks file; None where it has none.

    `left_hand`, `right_hand`: (T, 21, 3) or (T, 63), x, y in pixels and confidence, as OpenPose and MediaPipe number
    them; with them `left_hand_world`, `right_hand_world` (T, 21, 3) metres. Or `wholebody` (T, 133, 3) in the order of
    COCO-WholeBody. scale: (T,) pixels a metre at the person. Raises UserError for other shapes, and for NaN that counts
    as seen.
    """
    found = HandLandmarks.unseen(len(scale))
    if "wholebody" in arrays:
        points = _shaped(path, "wholebody", arrays["wholebody"], len(scale), WHOLE_BODY)
        pairs = [points[:, start : start + 21] for start in _BEGIN]
    elif any(f"{side}_hand" in arrays for side in SIDES):
        pairs = [_shaped(path, f"{side}_hand", arrays[f"{side}_hand"], len(scale), 21) if f"{side}_hand" in arrays
                 else np.zeros((len(scale), 21, 3)) for side in SIDES]  # fmt: skip
    else:
        return None
    for h, (side, points) in enumerate(zip(SIDES, pairs, strict=True)):
        # a hand counts as its least sure points do: half of them seen says nothing of the other fingers
        confidence = np.clip(np.quantile(points[..., 2], 0.25, axis=1), 0, 1)
        found.image[:, h] = np.where(confidence[:, None, None] > 0, points[..., :2], 0)
        found.weight[:, h] = confidence
        key = f"{side}_hand_world"
        if key in arrays:
            found.world[:, h] = _shaped(path, key, arrays[key], len(scale), 21)
    found.size[:] = LENGTH * scale[:, None]
    return found


def _shaped(path: Path, key: str, value: np.ndarray, frames: int, points: int) -> np.ndarray:
    """(T, points, 3) float64; what is not seen is zero."""
    if value.dtype.kind not in "fiu" or value.size != frames * points * 3 or len(value) != frames:
        raise UserError(
            f"{path}: '{key}' has shape {value.shape}, but {points} points in {frames} frames need "
            f"({frames}, {points}, 3)"
        )
    shaped = value.reshape(frames, points, 3).astype(np.float64)
    bad: np.ndarray = np.logical_not(np.isfinite(shaped).all(-1))
    if (bad & (shaped[..., 2] > 0)).any():
        frame, point = np.argwhere(bad & (shaped[..., 2] > 0))[0]
        raise UserError(f"{path}: '{key}' has NaN in frame {frame}, point {point}; write zeros for unseen points")
    return np.where(bad[..., None], 0, shaped)
