"""Images of a capture's views, decoded once and kept in memory at the size in use."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.values.camera import Camera

from ..capture.capture import Capture, View
from .remedies.matte import matted


@dataclasses.dataclass(frozen=True)
class Comparison:
    """B views beside what is drawn of them, over one background.

    target, render: (B, 3, H, W) the footage and the avatar. mask, alpha: (B, H, W) their coverage. All in [0, 1].
    """

    target: Tensor
    render: Tensor
    mask: Tensor
    alpha: Tensor

    @staticmethod
    def joined(parts: list[Comparison]) -> Comparison:
        """The views of all parts in one."""
        names = [field.name for field in dataclasses.fields(Comparison)]
        return Comparison(*(torch.cat([getattr(part, name) for part in parts]) for name in names))


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


class FootageSource:
    """The images of some views of a capture at any scale, decoded at most once, when they are first asked for.

    crop, mask_matte: as in `TrainConfig`. bar: shows how far the decoding is.
    """

    def __init__(
        self,
        capture: Capture,
        views: list[View],
        *,
        crop: bool = True,
        mask_matte: float = 0,
        bar: Callable[[Iterable], Iterable] = iter,
    ):
        self.capture, self.views = capture, views
        self.crop, self.mask_matte, self.bar = crop, mask_matte, bar
        self._full: list[tuple[np.ndarray, np.ndarray]] | None = None
        self._latest: tuple[float, Footage] | None = None

    def at(self, scale: float) -> Footage:
        """The views' footage at an image scale; that of the last scale asked for is kept."""
        if self._latest is None or self._latest[0] != scale:
            if self._full is None:
                self._full = load_full(self.capture, self.views, self.bar, self.mask_matte)
            images = footage(self.capture, self.views, self._full, scale, self.crop)
            self._latest = scale, images
        return self._latest[1]


def load_full(
    capture: Capture, views: list[View], progress: Callable[[Iterable], Iterable] = iter, mask_matte: float = 0
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Every view as (H, W, 3) uint8 premultiplied colour and (H, W) uint8 alpha, at the capture's own size.

    mask_matte: pixels inside a mask's border in which alpha is found anew (`matted`).
    """
    images = []
    for view in progress(views):
        color, alpha = capture.load(view)
        if mask_matte != 0:
            image = capture.read(view)[0][..., ::-1].astype(np.float32) / 255
            anew, share = matted(image, alpha, mask_matte)
            changed = share != alpha
            color, alpha = np.where(changed[..., None], anew, color), share
        images.append((np.round(color * 255).astype(np.uint8), np.round(alpha * 255).astype(np.uint8)))
    return images


def footage(
    capture: Capture,
    views: list[View],
    full: list[tuple[np.ndarray, np.ndarray]],
    scale: float,
    crop: bool,
) -> Footage:
    """The images of `load_full` resized by `scale` (area-averaged) and, if `crop`, cut to the person.

    Every window has the size of the largest person plus a margin of an eighth on each side, so that a body still out of
    place is seen; sides are multiples of 16 when cropped.
    """
    sized: list[tuple[Any, ...]] = []
    for view, (color, alpha) in zip(views, full, strict=True):
        camera = capture.camera(view).scaled(scale)
        images = [color, alpha]
        size = (camera.width, camera.height)
        if size != (color.shape[1], color.shape[0]):
            mode = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
            images = [cv2.resize(image, size, interpolation=mode) for image in images]
        sized.append((camera, *images))
    if crop:
        sized = _crop(sized)
    cameras, colors, alphas = zip(*sized, strict=True)
    return Footage(
        views,
        list(cameras),
        torch.from_numpy(np.stack(colors)).permute(0, 3, 1, 2).contiguous(),
        torch.from_numpy(np.stack(alphas)),
    )


def _crop(sized: list) -> list:
    found = []
    for camera, _, alpha, *_ in sized:
        rows, cols = np.flatnonzero(alpha.any(1)), np.flatnonzero(alpha.any(0))
        whole = (0, 0, camera.width, camera.height)
        found.append((cols[0], rows[0], cols[-1] + 1, rows[-1] + 1) if len(rows) else whole)
    boxes = np.array(found)
    extent = (boxes[:, 2:] - boxes[:, :2]).max(0) * 1.25
    limit = np.max([[camera.width, camera.height] for camera, *_ in sized], 0)
    width, height = (int(v) for v in np.minimum(np.ceil(extent / 16) * 16, limit))
    out = []
    for (camera, *images), box in zip(sized, boxes, strict=True):
        left = int(np.clip((box[0] + box[2] - width) // 2, 0, max(0, camera.width - width)))
        top = int(np.clip((box[1] + box[3] - height) // 2, 0, max(0, camera.height - height)))
        images = [image[top : top + height, left : left + width] for image in images]
        pad = ((0, height - images[0].shape[0]), (0, width - images[0].shape[1]))  # cameras of different sizes
        color, *others = images
        padded = [np.pad(color, (*pad, (0, 0))), *(np.pad(image, pad) for image in others)]
        out.append((camera.cropped(left, top, width, height), *padded))
    return out
