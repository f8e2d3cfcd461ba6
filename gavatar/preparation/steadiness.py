"""Did the camera stand still? The background's corners are followed from the first frame."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

STEADY = 0.004  # of the image's longer side: shake that a body fit does not notice
_CORNERS, _SIDE = 300, 480
_CONTRAST = 6  # grey levels, standard deviation around a corner


class Steadiness:
    """Fed image by image; `moved` is how far the background went, as a fraction of the image's longer side."""

    def __init__(self) -> None:
        self.first: np.ndarray | None = None
        self.corners: np.ndarray | None = None
        self.moves: list[float] = []

    def add(self, image: np.ndarray, mask: np.ndarray) -> None:
        """image: (H, W, 3) uint8 BGR. mask: (H, W) uint8, the person, whose surroundings are left out."""
        scale = min(1.0, _SIDE / max(image.shape[:2]))
        size = max(8, round(image.shape[1] * scale)), max(8, round(image.shape[0] * scale))
        grey = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        person = cv2.dilate(cv2.resize(mask, size, interpolation=cv2.INTER_AREA), np.ones((15, 15)))
        if self.first is None:
            self.first = grey
            # corners are judged beside the best one: on a plain wall those would be the codec's noise
            values = grey.astype(np.float32)
            contrast = np.sqrt(np.maximum(cv2.blur(values**2, (9, 9)) - cv2.blur(values, (9, 9)) ** 2, 0))
            free = np.where((person > 20) | (contrast < _CONTRAST), 0, 255).astype(np.uint8)
            self.corners = cv2.goodFeaturesToTrack(grey, _CORNERS, 0.02, 7, mask=free)
            return
        if self.corners is None or len(self.corners) < 8:
            return
        guess: Any = None  # OpenCV's types know no flow without one
        there, found, _ = cv2.calcOpticalFlowPyrLK(self.first, grey, self.corners, guess)
        back, returned, _ = cv2.calcOpticalFlowPyrLK(grey, self.first, there, guess)
        good = np.logical_and(found, returned).ravel()
        good &= np.linalg.norm((back - self.corners).reshape(-1, 2), axis=1) < 1
        x, y = np.clip(there.reshape(-1, 2).round().astype(int), 0, np.array(size) - 1).T
        good &= person[y, x] <= 20  # the person walks before some corners
        if good.sum() >= 8:
            step = np.median((there - self.corners).reshape(-1, 2)[good], axis=0)
            self.moves.append(float(np.hypot(*step)) / max(size))

    @property
    def moved(self) -> float | None:
        """The largest move that at least a tenth of the frames exceed; None when the background shows nothing to
        follow."""
        return float(np.quantile(self.moves, 0.9)) if len(self.moves) >= 2 else None
