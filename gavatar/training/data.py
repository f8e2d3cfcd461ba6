"""Training images, decoded once and kept in memory at the level's size."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.camera import Camera

from ..capture import Capture, View


@dataclasses.dataclass
class Footage:
    """Views of a capture at one image scale, cropped to windows of one common size.

    views: V views. cameras: their (cropped) cameras. color: (V, 3, H, W) uint8 premultiplied. alpha: (V, H, W) uint8.
    """

    views: list[View]
    cameras: list[Camera]
    color: Tensor
    alpha: Tensor

    def batch(self, rows: list[int], background: Tensor, device: torch.device) -> tuple[Tensor, Tensor]:
        """(B, 3, H, W) footage composited over `background` (3,) and (B, H, W) masks, float32 in [0, 1]."""
        color = self.color[rows].to(device).float() / 255
        alpha = self.alpha[rows].to(device).float() / 255
        return color + (1 - alpha[:, None]) * background[:, None, None].to(device), alpha


def load_full(capture: Capture, views: list[View], progress=iter) -> list[tuple[np.ndarray, np.ndarray]]:
    """Every view as (H, W, 3) uint8 premultiplied colour and (H, W) uint8 alpha, at the capture's own size."""
    images = []
    for view in progress(views):
        color, alpha = capture.load(view)
        images.append((np.round(color * 255).astype(np.uint8), np.round(alpha * 255).astype(np.uint8)))
    return images


def footage(
    capture: Capture, views: list[View], full: list[tuple[np.ndarray, np.ndarray]], scale: float, crop: bool
) -> Footage:
    """The images of `load_full` resized by `scale` (area-averaged) and, if `crop`, cut to the person.

    Every window has the size of the largest person plus a margin of an eighth on each side, so that a body still out of
    place is seen; sides are multiples of 16 when cropped.
    """
    sized = []
    for view, (color, alpha) in zip(views, full, strict=True):
        camera = capture.camera(view).scaled(scale)
        size = (camera.width, camera.height)
        if size != (color.shape[1], color.shape[0]):
            mode = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
            color, alpha = cv2.resize(color, size, interpolation=mode), cv2.resize(alpha, size, interpolation=mode)
        sized.append((camera, color, alpha))
    if crop:
        sized = _crop(sized)
    return Footage(
        views,
        [camera for camera, _, _ in sized],
        torch.from_numpy(np.stack([color for _, color, _ in sized])).permute(0, 3, 1, 2).contiguous(),
        torch.from_numpy(np.stack([alpha for _, _, alpha in sized])),
    )


def _crop(sized: list) -> list:
    boxes = []
    for camera, _, alpha in sized:
        rows, cols = np.flatnonzero(alpha.any(1)), np.flatnonzero(alpha.any(0))
        whole = (0, 0, camera.width, camera.height)
        boxes.append((cols[0], rows[0], cols[-1] + 1, rows[-1] + 1) if len(rows) else whole)
    boxes = np.array(boxes)
    extent = (boxes[:, 2:] - boxes[:, :2]).max(0) * 1.25
    limit = np.max([[camera.width, camera.height] for camera, _, _ in sized], 0)
    width, height = (int(v) for v in np.minimum(np.ceil(extent / 16) * 16, limit))
    out = []
    for (camera, color, alpha), box in zip(sized, boxes, strict=True):
        left = int(np.clip((box[0] + box[2] - width) // 2, 0, max(0, camera.width - width)))
        top = int(np.clip((box[1] + box[3] - height) // 2, 0, max(0, camera.height - height)))
        color, alpha = color[top : top + height, left : left + width], alpha[top : top + height, left : left + width]
        pad = ((0, height - color.shape[0]), (0, width - color.shape[1]))  # cameras of different sizes
        out.append((camera.cropped(left, top, width, height), np.pad(color, (*pad, (0, 0))), np.pad(alpha, pad)))
    return out
