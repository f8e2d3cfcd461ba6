"""Reading a video back."""

from __future__ import annotations

import cv2
import numpy as np


def frames_of(path) -> list[np.ndarray]:
    """The frames of a video, (H, W, 3) uint8 RGB, until it ends."""
    video, frames = cv2.VideoCapture(str(path)), []
    while True:
        ok, image = video.read()
        if not ok:
            return frames
        frames.append(image[..., ::-1])
