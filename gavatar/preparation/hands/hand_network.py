"""MediaPipe's hand networks run by ONNX Runtime: the crop around a hand, its 21 landmarks.

What surrounds the networks (the crop from the body's landmarks, its refinement, the crop that follows a hand) does as
the published graphs of mediapipe/modules/hand_landmark and holistic_landmark do. Source: Zhang et al., "MediaPipe
Hands: On-device Real-time Hand Tracking", 2020.
"""

from __future__ import annotations

import dataclasses
from importlib.resources import as_file, files

import numpy as np

from ..pose_network import Region, open_network

CROP_SIDE, RECROP_SIDE = 224, 256
FROM_POSE, FROM_HAND = 2.7, 2.0  # sides of crops: of twice the palm's length, of the box around palm and knuckles
SHIFT = 0.1  # of a crop's side, towards the fingers
_PALM = np.array([0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18])  # points whose box a crop is laid around


@dataclasses.dataclass(frozen=True)
class SeenHand:
    """The network's answer for one crop. presence: in [0, 1]. right: in [0, 1], how surely it is a right hand. image:
    (21, 3) pixels x, y and depth relative to the wrist. world: (21, 3) metres along camera axes. region: the crop."""

    presence: float
    right: float
    image: np.ndarray
    world: np.ndarray
    region: Region

    @property
    def following(self) -> Region:
        """Where to look in the next frame."""
        points = self.image[:, :2]
        ahead = 0.5 * (0.5 * (points[5] + points[13]) + points[9])
        return upright(points[_PALM], ahead - points[0], FROM_HAND)


def upright(points: np.ndarray, ahead: np.ndarray, scale: float) -> Region:
    """A square `scale` times as large as the box around `points` (N, 2), turned so that `ahead` (2,) is up in it."""
    angle = _up(ahead)
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])  # from the crop's axes to the image's
    local = points @ R
    low, high = local.min(0), local.max(0)
    side = float((high - low).max()) * scale
    return Region(R @ (0.5 * (low + high)) + R @ [0, -SHIFT * side / scale], side, angle)


def guided(wrist: np.ndarray, index: np.ndarray, pinky: np.ndarray) -> Region:
    """The square in which a hand is sought, from three points (2,) of the body, pixels."""
    middle = (2 * index + pinky) / 3
    side = 2 * float(np.linalg.norm(middle - wrist))
    angle = _up(middle - wrist)
    forward = np.array([np.sin(angle), -np.cos(angle)])
    return Region(middle + forward * SHIFT * side, FROM_POSE * side, angle)


def _up(direction: np.ndarray) -> float:
    """The angle by which `direction` (2,) is turned from straight up, clockwise on the screen."""
    return float(np.arctan2(direction[0], -direction[1]))


class HandNetworks:
    """The two networks, loaded once."""

    def __init__(self) -> None:
        with as_file(files("gavatar.data") / "hands") as folder:
            self.recropper = open_network(folder / "hand_recrop.onnx")
            self.landmarker = open_network(folder / "hand_landmark_full.onnx")

    def recrop(self, image: np.ndarray, region: Region) -> Region:
        """A better crop of the hand that lies somewhere in `region` of an image (H, W, 3) uint8 BGR."""
        crop = region.crop(image, RECROP_SIDE)[..., ::-1].astype(np.float32) / 255
        (found,) = self.recropper.run(None, {"image": crop[None]})
        M = region.to_image(RECROP_SIDE)
        centre, rim = found.reshape(2, 2).astype(np.float64) @ M[:, :2].T + M[:, 2]
        side = 2 * float(np.linalg.norm(rim - centre))
        angle = _up(rim - centre)
        return Region(centre + np.array([np.sin(angle), -np.cos(angle)]) * SHIFT * side, side, angle)

    def landmarks(self, image: np.ndarray, region: Region) -> SeenHand:
        """The hand in `region` of an image (H, W, 3) uint8 BGR."""
        crop = region.crop(image, CROP_SIDE)[..., ::-1].astype(np.float32) / 255
        points, presence, right, world = self.landmarker.run(None, {"image": crop[None]})
        local = points.reshape(21, 3).astype(np.float64)
        M = region.to_image(CROP_SIDE)
        c, s = np.cos(region.angle), np.sin(region.angle)
        turned = world.reshape(21, 3).astype(np.float64) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        pixels = np.c_[local[:, :2] @ M[:, :2].T + M[:, 2], local[:, 2] * region.side / CROP_SIDE]
        return SeenHand(float(presence[0, 0]), float(right[0, 0]), pixels, turned, region)
