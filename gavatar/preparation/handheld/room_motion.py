"""How the room moves in the picture, frame by frame: corners beside the person are followed from key frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np

CORNERS, SIDE = 400, 640  # corners that are followed, pixels of the longer side while they are
LEAST = 16  # corners that say how the room moved
LOST = 0.4  # of a key frame's corners: with fewer the last frame becomes the next key frame
MISS = 1.5  # pixels within which a corner agrees with the others
MOST_LOST = 0.1  # of the frames that may show too little of the room


@dataclasses.dataclass(frozen=True)
class RoomMotion:
    """to_frame: (T, 3, 3) homographies from pixels of frame `reference` to those of each frame, continuous pixels
    (centres at + 0.5). miss: median distance between corners and their homography, of the picture's longer side: a
    room with depth that a camera travels through moves by no homography."""

    to_frame: np.ndarray
    reference: int
    miss: float

    def taken(self, rows: slice | np.ndarray) -> RoomMotion:
        """That of some of the frames; the middle one of them is the reference."""
        chosen = self.to_frame[rows]
        middle = len(chosen) // 2
        return RoomMotion(normalised(chosen @ np.linalg.inv(chosen[middle])), middle, self.miss)

    def scaled(self, x: float, y: float) -> RoomMotion:
        """That of pictures enlarged by factors."""
        S = np.diag([x, y, 1.0])
        return dataclasses.replace(self, to_frame=normalised(S @ self.to_frame @ np.linalg.inv(S)))


def normalised(H: np.ndarray) -> np.ndarray:
    """(..., 3, 3) homographies whose last number is 1."""
    result: np.ndarray = H / H[..., 2:, 2:]
    return result


def measure_room_motion(images: Iterable[np.ndarray], masks: Iterable[np.ndarray]) -> RoomMotion | None:
    """None where too many frames show too little of the room. images: (H, W, 3) uint8 BGR. masks: (H, W) uint8."""
    follower, steps, scale = _Follower(), [], 1.0
    for image, mask in zip(images, masks, strict=True):
        scale = min(1.0, SIDE / max(image.shape[:2]))
        size = max(8, round(image.shape[1] * scale)), max(8, round(image.shape[0] * scale))
        grey = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        person = cv2.dilate(cv2.resize(mask, size, interpolation=cv2.INTER_AREA), np.ones((21, 21))) > 20
        steps.append(follower.add(grey, person))
    if len(steps) < 2 or follower.lost > MOST_LOST * len(steps):
        return None
    back = np.diag([1 / scale, 1 / scale, 1.0])
    H = normalised(back @ np.array(steps) @ np.linalg.inv(back))
    miss = float(np.median(follower.misses)) / SIDE if follower.misses else 0.0
    return RoomMotion(H, 0, miss).taken(slice(None))


class _Follower:
    """Fed frame by frame; gives homographies from the first one."""

    def __init__(self) -> None:
        self.key: np.ndarray | None = None
        self.corners: Any = np.zeros((0, 1, 2), np.float32)  # (K, 1, 2) float32
        self.key_to_first, self.last = np.eye(3), np.eye(3)  # of the key frame; from the key frame to the last one
        self.before: tuple[np.ndarray, np.ndarray] | None = None
        self.misses: list[float] = []
        self.lost = 0

    def add(self, grey: np.ndarray, person: np.ndarray) -> np.ndarray:
        """(3, 3) from the first frame's pixels to this one's."""
        if self.key is None:
            self._start(grey, person)
            return np.eye(3)
        found = self._follow(grey, person)
        few = found is None or found[1] < LOST * len(self.corners)
        if few and self.before is not None:  # the frame before becomes the key frame, from which this one is followed
            self.key_to_first = self.last @ self.key_to_first
            self._start(*self.before)
            found = self._follow(grey, person)
        if found is None:
            self.lost += 1
        else:
            self.last = found[0]
        self.before = grey, person
        first: np.ndarray = normalised(self.last @ self.key_to_first)
        return first

    def _start(self, grey: np.ndarray, person: np.ndarray) -> None:
        self.key, self.last, self.before = grey, np.eye(3), None
        free = np.where(person, 0, 255).astype(np.uint8)
        corners = cv2.goodFeaturesToTrack(grey, CORNERS, 0.01, 7, mask=free)
        self.corners = np.zeros((0, 1, 2), np.float32) if corners is None else corners

    def _follow(self, grey: np.ndarray, person: np.ndarray) -> tuple[np.ndarray, int] | None:
        """From the key frame to this one, and how many corners agree."""
        if self.key is None or len(self.corners) < LEAST:
            return None
        guess: Any = cv2.perspectiveTransform(self.corners, _to_centres(self.last))
        there: Any
        back: Any
        there, found, _ = cv2.calcOpticalFlowPyrLK(
            self.key, grey, self.corners, guess.copy(), winSize=(21, 21), maxLevel=4, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
        )
        back, returned, _ = cv2.calcOpticalFlowPyrLK(
            grey, self.key, there, self.corners.copy(), winSize=(21, 21), maxLevel=4, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
        )
        good = np.logical_and(found, returned).ravel()
        good &= np.linalg.norm((back - self.corners).reshape(-1, 2), axis=1) < 1
        h, w = grey.shape
        x, y = there.reshape(-1, 2).round().astype(int).T
        good &= (x >= 0) & (y >= 0) & (x < w) & (y < h)
        good &= ~person[np.clip(y, 0, h - 1), np.clip(x, 0, w - 1)]
        if good.sum() < LEAST:
            return None
        a, b = self.corners[good].reshape(-1, 2), there[good].reshape(-1, 2)
        H, agree = cv2.findHomography(a + 0.5, b + 0.5, cv2.RANSAC, MISS, maxIters=2000, confidence=0.999)
        if H is None or not np.isfinite(H).all() or agree.sum() < LEAST:
            return None
        off = cv2.perspectiveTransform(a[:, None] + 0.5, H)[:, 0] - (b + 0.5)
        self.misses.append(float(np.median(np.linalg.norm(off, axis=1))))
        return H, int(agree.sum())


def _to_centres(H: np.ndarray) -> np.ndarray:
    """A homography of continuous pixels as one of cv2's (centres at whole numbers)."""
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    return np.linalg.inv(shift) @ H @ shift
