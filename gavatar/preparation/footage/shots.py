"""Where footage is cut, and where another person takes over: by how much pictures differ.

Measured on every camera of the captures (studio_demo, studio_male, studio_dress, real_turn, real_p2s), every frame and
every sixth, against every pair of them cut together: see tests/gavatar/preparation/footage/test_shots.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np

SIDE = 32  # pixels of the thumbnails that are compared
# Of two frames: most uncut, least across a cut between scenes. A cut has all three.
STILL = 0.03  # median change of a pixel, which a person does not reach: 0.008, 0.07
COLOURS = 0.16  # share of the pixels whose colour the other has not: 0.12, 0.21
# 1 - correlation of grey thumbnails, which light does not change: 0.14 (0.37 before a plain wall, which STILL leaves
# out), 0.37
SHAPES = 0.25
ABRUPT = 4.0  # times the changes around it, against a camera that pans
AROUND = 3  # frames on either side that are compared
OTHER = 0.3  # as COLOURS of the person before and after: 0.27 for one person who turns, 0.33 for two


def find_cuts(images: Iterable[np.ndarray]) -> list[int]:
    """The frames with which a new scene begins. images: (H, W, 3) uint8 BGR, read one after the other."""
    changes, last = [], None
    for image in images:
        new = _thumbnail(image)
        if last is not None:
            changes.append(_change(last, new))
        last = new
    table = np.array(changes).reshape(-1, 3)
    high = (table > [STILL, COLOURS, SHAPES]).all(1)
    cuts = []
    for k in np.flatnonzero(high):
        beside = np.r_[table[max(0, k - AROUND) : k, 0], table[k + 1 : k + 1 + AROUND, 0]]
        if not len(beside) or table[k, 0] > ABRUPT * np.median(beside):
            cuts.append(int(k) + 1)
    return cuts


def _thumbnail(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Blurred colours (SIDE, SIDE, 3) in [0, 1] and the shares of 512 colours."""
    small = cv2.resize(image, (4 * SIDE, 4 * SIDE), interpolation=cv2.INTER_AREA)
    counts = cv2.calcHist([small], [0, 1, 2], None, [8, 8, 8], [0, 256] * 3).reshape(-1)
    tiny = cv2.GaussianBlur(cv2.resize(small, (SIDE, SIDE), interpolation=cv2.INTER_AREA), (0, 0), 1)
    return tiny.astype(np.float32) / 255, counts / counts.sum()


def _change(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> tuple[float, float, float]:
    grey, other = (x[0].mean(2) - x[0].mean() for x in (a, b))
    norm = float(np.sqrt((grey**2).sum() * (other**2).sum()))
    alike = float((grey * other).sum()) / norm if norm > 1e-6 else 0.0  # nothing to see in one of them
    return float(np.median(np.abs(a[0] - b[0]))), _unlike(a[1], b[1]), 1 - alike


def _unlike(a: np.ndarray, b: np.ndarray) -> float:
    """1 - the overlap of two distributions."""
    return float(1 - np.minimum(a, b).sum())


class Wardrobe:
    """Remembers in what colours the followed person is seen, frame by frame."""

    def __init__(self) -> None:
        self.colours: list[np.ndarray | None] = []

    def add(self, image: np.ndarray, mask: np.ndarray) -> None:
        """image: (H, W, 3) uint8 BGR. mask: (H, W) uint8, the person above 127; empty where nobody was found."""
        x, y, w, h = cv2.boundingRect(mask)
        inside = (mask[y : y + h, x : x + w] > 127).astype(np.uint8)
        if inside.sum() < 100:
            self.colours.append(None)
            return
        part = cv2.cvtColor(image[y : y + h, x : x + w], cv2.COLOR_BGR2LAB)
        counts = cv2.calcHist([part], [0, 1, 2], inside, [8, 16, 16], [0, 256] * 3)
        counts = np.stack([cv2.GaussianBlur(layer, (0, 0), 0.7) for layer in counts]).reshape(-1)
        self.colours.append(counts / counts.sum())

    def changes(self) -> list[int]:
        """The frames with which somebody else begins: their colours are others for `AROUND` frames on either side."""
        known = [t for t, colours in enumerate(self.colours) if colours is not None]
        seen = [colours for colours in self.colours if colours is not None]
        scores = np.zeros(len(known))
        for k in range(AROUND, len(known) - AROUND + 1):
            before, after = (np.mean(seen[a : a + AROUND], axis=0) for a in (k - AROUND, k))
            scores[k] = _unlike(before, after)
        peaks = [k for k in np.flatnonzero(scores > OTHER)
                 if scores[k] == scores[max(0, k - AROUND) : k + AROUND + 1].max()]  # fmt: skip
        kept: list[int] = []
        for peak in peaks:  # of neighbours that are equal, the first
            if not kept or peak - kept[-1] > AROUND:
                kept.append(int(peak))
        return [known[k] for k in kept]


def longest(starts: Sequence[int], count: int) -> slice:
    """Of `count` frames, cut where `starts` say, the longest piece (of equal ones the first)."""
    edges = [0, *starts, count]
    k = int(np.argmax(np.diff(edges)))
    return slice(edges[k], edges[k + 1])
