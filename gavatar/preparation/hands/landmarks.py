"""The 21 points of a hand, as MediaPipe, OpenPose and COCO-WholeBody order them."""

from __future__ import annotations

import dataclasses

import numpy as np

SIDES = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
POINTS = ("wrist", *(f"{finger}{k}" for finger in FINGERS for k in (1, 2, 3, 4)))  # the fourth is the finger's tip
PLACE = {name: k for k, name in enumerate(POINTS)}
BONES = (
    *((0 if k == 0 else 4 * f + k, 4 * f + k + 1) for f in range(5) for k in range(4)),
    *((PLACE["index1"], PLACE["pinky1"]), (PLACE["wrist"], PLACE["middle1"]), (PLACE["thumb1"], PLACE["index1"])),
)
LENGTH = 0.18  # metres of a hand from the wrist to the middle finger's tip, for sizes in pixels
LEAST_SIDE = 24.0  # pixels of that length below which fingers are not told apart


@dataclasses.dataclass(frozen=True)
class HandLandmarks:
    """What was seen of the left and the right hand in T frames of one camera.

    image: (T, 2, 21, 2) pixels. world: (T, 2, 21, 3) metres around the hand, along the camera's axes (x right, y down,
    z away); zeros where not known. weight: (T, 2) in [0, 1], how far the points are to be believed: presence times
    sharpness, 0 where no hand was found. size: (T, 2) pixels of an outstretched hand there.
    """

    image: np.ndarray
    world: np.ndarray
    weight: np.ndarray
    size: np.ndarray

    @staticmethod
    def unseen(frames: int) -> HandLandmarks:
        """Of frames in which no hand was found."""
        return HandLandmarks(np.zeros((frames, 2, 21, 2)), np.zeros((frames, 2, 21, 3)), np.zeros((frames, 2)),
                             np.zeros((frames, 2)))  # fmt: skip

    def __getitem__(self, frames: slice | np.ndarray) -> HandLandmarks:
        return HandLandmarks(self.image[frames], self.world[frames], self.weight[frames], self.size[frames])

    @property
    def believed(self) -> np.ndarray:
        """(T, 2) `weight`, 0 where a hand is too small for its fingers to be told apart."""
        return np.where(self.size >= LEAST_SIDE, self.weight, 0)


def pixels_per_metre(image: np.ndarray, world: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(...) how large a body is seen, from those of its points (..., N, 2) in pixels and (..., N, 3) in metres that
    were `seen` (..., N); 0 where none was."""
    count = np.maximum(seen.sum(-1), 1)[..., None, None]
    spread = []
    for points in (image, world[..., :2]):
        known = points * seen[..., None]
        around = (known - known.sum(-2, keepdims=True) / count) * seen[..., None]
        spread.append(np.linalg.norm(around, axis=(-2, -1)))
    return np.where(spread[1] > 1e-6, spread[0] / np.maximum(spread[1], 1e-6), 0)
