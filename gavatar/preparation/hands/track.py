"""Following both hands through the frames of one camera, guided by the body's landmarks."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import cv2
import numpy as np

from ..landmarks import INDEX
from ..pose_network import Pose, Region
from .hand_network import HandNetworks, SeenHand, guided
from .landmarks import LENGTH, SIDES, HandLandmarks, pixels_per_metre

PRESENT = 0.5  # least presence, as in the published graph
SURE = 0.9  # presence at which no other crop is tried
AWAY = 0.12  # metres between the body's wrist and the hand's beyond which another hand was found
CERTAIN = 0.3  # least visibility of the points from which the size of the person is taken
PALM = 0.5  # of a hand's length: how far beyond the wrist its middle lies
_GUIDES = [[INDEX[f"{side}_{name}"] for name in ("wrist", "index", "pinky")] for side in SIDES]
_ELBOWS = [INDEX[f"{side}_elbow"] for side in SIDES]


class HandTracker:
    """Looks for both hands in one frame after the other."""

    def __init__(self, networks: HandNetworks, frames: int):
        self.networks = networks
        self.found = HandLandmarks.unseen(frames)
        self.sharpness = np.full((frames, 2), np.nan)
        self.last: list[SeenHand | None] = [None, None]

    def look(self, t: int, image: np.ndarray, pose: Pose | None) -> None:
        """Find the hands in frame `t`, (H, W, 3) uint8 BGR, in which the body was found as `pose` says."""
        if pose is None:
            self.last = [None, None]
            return
        scale = float(pixels_per_metre(pose.image[:, :2], pose.world, pose.visibility > CERTAIN))
        for side, guides in enumerate(_GUIDES):
            hand = self._hand(image, pose.image[guides, :2], pose.image[_ELBOWS[side], :2], scale, self.last[side])
            self.last[side] = hand
            if hand is None:
                continue
            self.found.image[t, side], self.found.world[t, side] = hand.image[:, :2], hand.world
            self.found.weight[t, side] = hand.presence
            self.found.size[t, side] = LENGTH * scale
            self.sharpness[t, side] = _sharpness(image, hand.region)

    def result(self) -> HandLandmarks:
        """What was found; frames that are blurred beside the others are believed less."""
        share = np.ones_like(self.sharpness)
        if np.isfinite(self.sharpness).any():
            typical = float(np.nanmedian(self.sharpness))
            share = np.clip(np.nan_to_num(self.sharpness) / max(0.5 * typical, 1e-9), 0.1, 1)
        return dataclasses.replace(self.found, weight=self.found.weight * share)

    def _hand(
        self, image: np.ndarray, guides: np.ndarray, elbow: np.ndarray, scale: float, last: SeenHand | None
    ) -> SeenHand | None:
        """The hand near three points of the body, (3, 2) pixels; None where there is none."""
        wrist, height, width = guides[0], *image.shape[:2]
        if not (0 <= wrist[0] <= width and 0 <= wrist[1] <= height):
            return None
        best: SeenHand | None = None
        for k, region in enumerate(self._regions(image, guides, elbow, scale, last)):
            hand = self.networks.landmarks(image, region)
            near = np.linalg.norm(hand.image[0, :2] - wrist) < AWAY * scale
            if not near or hand.presence < 0.3:
                continue
            if k > 0 or last is None:  # a guided crop frames a hand roughly: ask again where its points say it is
                again = self.networks.landmarks(image, hand.following)
                hand = again if again.presence > hand.presence else hand
            if best is None or hand.presence > best.presence:
                best = hand
            if best.presence > SURE:
                break
        return best if best is not None and best.presence >= PRESENT else None

    def _regions(self, image: np.ndarray, guides: np.ndarray, elbow: np.ndarray, scale: float, last: SeenHand | None
                 ) -> Iterator[Region]:  # fmt: skip
        """Where a hand may be, the likeliest first: where it was, where the body's three points say it is, and
        straight on from the forearm at the size that the body has."""
        if last is not None:
            yield last.following
        yield self.networks.recrop(image, guided(*guides))
        yield guided(*guides)
        ahead = guides[0] - elbow
        yield _beyond(guides[0], ahead, scale)
        yield _beyond(guides[0], 2 * guides[1] + guides[2] - 3 * guides[0], scale)


def _beyond(wrist: np.ndarray, ahead: np.ndarray, scale: float) -> Region:
    angle = float(np.arctan2(ahead[0], -ahead[1]))
    forward = np.array([np.sin(angle), -np.cos(angle)])
    return Region(wrist + forward * (PALM * LENGTH * scale), 2 * LENGTH * scale, angle)


def _sharpness(image: np.ndarray, region: Region) -> float:
    """Variance of the second derivatives over the contrast, in the crop at 64 pixels so that sizes compare."""
    grey = cv2.cvtColor(region.crop(image, 64), cv2.COLOR_BGR2GRAY).astype(np.float64)
    return float(cv2.Laplacian(grey, cv2.CV_64F).var() / max(grey.var(), 25.0))
