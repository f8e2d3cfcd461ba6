"""Pictures of a run as it goes: target, render and error side by side."""

from __future__ import annotations

import cv2
import numpy as np
from torch import Tensor


def as_image(tensor: Tensor) -> np.ndarray:
    """(3, H, W) tensor -> (H, W, 3) float32 array."""
    return tensor.detach().float().cpu().permute(1, 2, 0).numpy()


def error_map(target: np.ndarray, render: np.ndarray) -> np.ndarray:
    """(H, W, 3) colours of the absolute error, averaged over channels; black 0, yellow-white 0.25 and above."""
    error = np.abs(target - render).mean(-1)
    levels = np.round(np.clip(error / 0.25, 0, 1) * 255).astype(np.uint8)
    return cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO)[..., ::-1].astype(np.float32) / 255


def side_by_side(target: np.ndarray, render: np.ndarray, height: int = 256) -> np.ndarray:
    """Target, render and error in one row, each enlarged to at least `height` rows by whole factors."""
    row = np.concatenate([target, render, error_map(target, render)], 1)
    factor = max(1, height // max(1, row.shape[0]))
    return np.repeat(np.repeat(row, factor, 0), factor, 1)


LIVE = "live.html"
LATEST = "latest.png"
PAGE = """<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="{seconds}"><title>{title}</title>
<body style="margin:2em;font:16px sans-serif;background:#222;color:#eee"><p>{title}</p>
<img src="{picture}?{stamp}" style="max-width:100%" alt="footage, avatar, error">
"""


def live_page(title: str, stamp: int, finished: bool = False) -> str:
    """A page that shows the latest picture of a training and loads itself again while that goes on. title: of what
    there is to see. stamp: another number for another picture, so that no browser shows the former one."""
    return PAGE.format(title=title, picture=LATEST, stamp=stamp, seconds=3600 if finished else 3)
