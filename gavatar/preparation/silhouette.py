"""Masks as constraints: the body stays inside and reaches the outline."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import cv2
import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.geometry.spacing import evenly_spaced

WORK_SIDE = 320  # pixels of a mask's longer side during the fit: half a pixel there is about 3 mm on a person


@dataclasses.dataclass(frozen=True)
class Silhouettes:
    """The masks of one camera's T frames, prepared for a fit.

    outside: (T, 1, h, w) distance to the mask, in pixels of the full image, 0 inside. outline: (T, N, 2) points of the
    mask's boundary in pixels of the full image; normal: (T, N, 2) outward unit normals; valid: (T, N), 0 for padding
    and for boundary along the image's edge, where the person merely leaves the picture. size: (width, height) of the
    full image.
    """

    outside: Tensor
    outline: Tensor
    normal: Tensor
    valid: Tensor
    size: tuple[int, int]


def prepare_silhouettes(masks: Iterable[np.ndarray], size: tuple[int, int], count: int = 300) -> Silhouettes:
    """masks: T arrays (H, W) uint8, the person above 127; read one after the other. An empty mask constrains nothing.
    size: (width, height) the landmarks are measured in."""
    scale = min(1.0, WORK_SIDE / max(size))
    w, h = max(2, round(size[0] * scale)), max(2, round(size[1] * scale))
    to_full = np.array([size[0] / w, size[1] / h], np.float32)
    parts = [_one_silhouette(mask, (w, h), to_full, count) for mask in masks]
    outside, outline, normal, valid = (torch.from_numpy(np.stack(part)) for part in zip(*parts, strict=True))
    return Silhouettes(outside, outline, normal, valid, size)


def _one_silhouette(mask: np.ndarray, work_size: tuple[int, int], to_full: np.ndarray, count: int) -> tuple:
    w, h = work_size
    outside, outline = np.zeros((1, h, w), np.float32), np.zeros((count, 2), np.float32)
    normal, valid = np.zeros((count, 2), np.float32), np.zeros(count, np.float32)
    small = _main_pieces((cv2.resize(mask, work_size, interpolation=cv2.INTER_AREA) > 127).astype(np.uint8))
    if small.any():
        outside[0] = cv2.distanceTransform(1 - small, cv2.DIST_L2, 5) * to_full.mean()
        points, normals = _outline(small)
        inner = (points > 2).all(1) & (points < [w - 2, h - 2]).all(1)
        points, normals = points[inner], normals[inner]
        pick = evenly_spaced(len(points), count)
        outline[: len(pick)], normal[: len(pick)] = points[pick] * to_full, normals[pick]
        valid[: len(pick)] = 1
    return outside, outline, normal, valid


def _main_pieces(mask: np.ndarray) -> np.ndarray:
    """Without specks: pieces under 2 % of the largest one."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    area = stats[:, cv2.CC_STAT_AREA]
    keep = np.zeros(count, np.uint8)
    if count > 1:
        keep[1:] = area[1:] >= 0.02 * area[1:].max()
    return keep[labels]


def _outline(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boundary pixels' centres (N, 2), in contour order, and outward normals from the smoothed mask's gradient."""
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    pixels = np.concatenate([c[:, 0] for c in contours])
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 2)
    gradient = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)], -1)
    normals = -gradient[pixels[:, 1], pixels[:, 0]]
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return pixels + 0.5, normals / np.maximum(length, 1e-6)


def outside_distance(silhouettes: Silhouettes, points: Tensor) -> Tensor:
    """(T, P) how far projected points (T, P, 2) lie outside the masks, pixels; differentiable."""
    size = torch.tensor(silhouettes.size, dtype=points.dtype)
    grid = (points / size * 2 - 1)[:, None]
    return torch.nn.functional.grid_sample(silhouettes.outside, grid, padding_mode="border", align_corners=False)[
        :, 0, 0
    ]


@torch.no_grad()
def nearest_to_outline(silhouettes: Silhouettes, points: Tensor) -> Tensor:
    """(T, N) which of the projected points (T, P, 2) is nearest to each point of the outline."""
    return torch.cdist(silhouettes.outline, points).argmin(-1)


def outline_gap(silhouettes: Silhouettes, points: Tensor, nearest: Tensor) -> Tensor:
    """(T, N) how far the point `nearest` stays short of the mask's outline, along the outline's normal, pixels;
    positive where the body does not reach (point-to-line distance, as in ICP). points: (T, P, 2)."""
    reached = torch.gather(points, 1, nearest[..., None].expand(-1, -1, 2))
    return ((silhouettes.outline - reached) * silhouettes.normal).sum(-1)
