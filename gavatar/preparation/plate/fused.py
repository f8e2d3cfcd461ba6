"""A network's coarse mask and a picture of the empty room, fused at full resolution into alpha.

Every pixel asks two things: does the network see a person here, and does the room explain its colour, shadows allowed?
The sum of both, as logarithms of odds, is smoothed along the image's edges; on the rim alpha is the share of the
person in the mixture `I = alpha F + (1 - alpha) B`, for B is known.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from ..matting import largest_piece
from .background import Background

SHADOW, LIGHT = 0.55, 1.12  # the room's light may fall to and rise to so much of itself: shadows, exposure
SHADED = 0.15  # probability that a pixel of the room is in such another light
EDGES = 0.5  # of the room's local contrast that its pixels may be off by: a codec, a lens that breathes
OUTLINE, TRUST = 0.025, 4.0  # of the person's size: what the network's outline may miss; logarithm of its odds there
BINS = 16  # of a channel, for the colours of the person
STRAY = 0.01  # probability of a colour that neither room nor person explains
# Largest logarithms of odds: of a colour against the person, who may wear the room's; for them; of network and colour.
ROOM_CAP, CAP, MOST_ODDS = 3.0, 6.0, 8.0
# of the guided filter: its radius, of the person's size; a flat window's variance
REACH, FLAT = 0.006, (0.02 * 255) ** 2
SURE_CONTRAST = 4.0  # of the noise, distance of the colours of person and room at which each counts half on the rim


@dataclasses.dataclass
class Colours:
    """How often the person shows each colour, learnt from what the network is sure of."""

    counts: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((BINS,) * 3, np.float32))

    def add(self, image: np.ndarray, mask: np.ndarray) -> None:
        """image: (H, W, 3) uint8 BGR. mask: (H, W) uint8, coarse."""
        _, _, w, h = cv2.boundingRect((mask > 127).astype(np.uint8))
        side = 2 * max(2, round(0.008 * max(w, h))) + 1
        sure = cv2.erode((mask > 127).astype(np.uint8), np.ones((side, side)))
        self.counts += cv2.calcHist([image], [0, 1, 2], sure, [BINS] * 3, [0, 256] * 3)

    def density(self) -> np.ndarray:
        """(BINS, BINS, BINS) probability of a colour, a grey level cubed."""
        smooth = np.stack([cv2.GaussianBlur(layer, (0, 0), 0.8) for layer in self.counts])
        smooth = np.moveaxis(
            np.stack([cv2.GaussianBlur(layer, (0, 0), 0.8) for layer in np.moveaxis(smooth, 0, 2)]), 2, 0
        )
        total = float(smooth.sum())
        share = smooth / total if total > 0 else np.full_like(smooth, 1 / smooth.size)
        return (0.9 * share + 0.1 / share.size) / (256 / BINS) ** 3


@dataclasses.dataclass
class Fuser:
    """Makes masks of one camera's footage before a known background."""

    background: Background
    colours: Colours

    def __post_init__(self) -> None:
        picture = self.background.picture.astype(np.float32)
        local = cv2.dilate(picture, np.ones((3, 3))) - cv2.erode(picture, np.ones((3, 3)))
        self.variance = self.background.noise**2 + (EDGES * local.mean(2)) ** 2
        self.density = self.colours.density()

    def __call__(self, image: np.ndarray, coarse: np.ndarray) -> np.ndarray:
        """(H, W) uint8 alpha. image: (H, W, 3) uint8 BGR. coarse: (H, W) uint8, of the network."""
        x, y, w, h = cv2.boundingRect((coarse > 127).astype(np.uint8))
        if min(w, h) < 4:
            return coarse
        mask = np.zeros(image.shape[:2], np.uint8)
        size, margin = max(w, h), max(8, round(0.1 * max(w, h)))
        part = slice(max(0, y - margin), y + h + margin), slice(max(0, x - margin), x + w + margin)
        I, B = (picture[part].astype(np.float32) for picture in (image, self.background.picture))
        known = self.background.known[part]
        odds, gain = self._colour_odds(I, B, self.variance[part])
        odds = np.clip(np.where(known > 0, odds, 0) + _prior_odds(coarse[part], size), -MOST_ODDS, MOST_ODDS)
        radius = max(2, round(REACH * size))
        smooth = cv2.ximgproc.guidedFilter(image[part], odds.astype(np.float32), radius, FLAT)
        solid = largest_piece((smooth > 0).astype(np.uint8))
        mask[part] = np.round(255 * _rim(I, B, gain, solid, known, self.background.noise, size))
        return mask

    def _colour_odds(self, I: np.ndarray, B: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(H, W) logarithm of the odds that a colour is the person's, and how bright the room would be there."""
        smooth = cv2.GaussianBlur(I, (0, 0), 0.8)
        bright = np.sqrt((B * B).sum(2)) + 20  # grey levels; of black light and shadow say nothing
        gain = (smooth * B).sum(2) / np.maximum((B * B).sum(2), 1)
        beside = np.square(smooth - gain[..., None] * B).sum(2) / variance
        along = np.square((gain - 1) * bright) / variance
        lit = np.exp(-0.5 * np.minimum(along, 80)) / np.sqrt(2 * np.pi * variance)
        shaded = ((gain > SHADOW) & (gain < LIGHT)) / ((LIGHT - SHADOW) * bright)
        room = np.exp(-0.5 * np.minimum(beside, 80)) / (2 * np.pi * variance)
        room *= (1 - SHADED) * lit + SHADED * shaded
        bins = np.minimum(smooth.astype(np.int32) * BINS // 256, BINS - 1)
        person = self.density[bins[..., 0], bins[..., 1], bins[..., 2]]
        stray = STRAY / 256**3
        odds = np.log(person + stray) - np.log((1 - STRAY) * room + stray)
        return np.clip(odds, -ROOM_CAP, CAP).astype(np.float32), np.clip(gain, SHADOW, LIGHT).astype(np.float32)


def _prior_odds(coarse: np.ndarray, size: int) -> np.ndarray:
    """(H, W) logarithm of the odds of a coarse mask (H, W) uint8: open on the outline, which it misses by some per cent
    of the person's size, ever more certain away from it, until colours have nothing to say."""
    inside = (coarse > 127).astype(np.uint8)
    depth = cv2.distanceTransform(inside, cv2.DIST_L2, 5) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)
    across = np.abs(depth) / (OUTLINE * size)
    odds: np.ndarray = np.sign(depth) * (np.minimum(across, 1) * TRUST + np.maximum(across - 1.5, 0) * 6)
    return odds


def _rim(I: np.ndarray, B: np.ndarray, gain: np.ndarray, solid: np.ndarray, known: np.ndarray, noise: float,
         size: int) -> np.ndarray:  # fmt: skip
    """(H, W) alpha in [0, 1]: that of `solid` (H, W) uint8 but for its rim, where it is the share of the person's
    colour nearby in the pixel, as far as that and the room's differ. Where the room is not known, it is
    taken to go on as it looks nearby."""
    width = max(2, round(REACH * size))
    box = np.ones((2 * width + 1,) * 2)
    inner, outer = cv2.erode(solid, box), 1 - cv2.dilate(solid, box)
    F = near_mean(I, inner, 3 * width)
    shade = near_mean(gain[..., None], outer & known, 3 * width)
    room = np.where(known[..., None] > 0, shade * B, near_mean(I, outer, 3 * width))
    apart = np.square(F - room).sum(2)
    share = np.clip(((I - room) * (F - room)).sum(2) / np.maximum(apart, 1), 0, 1)
    told = apart / (apart + (SURE_CONTRAST * noise) ** 2)
    crisp = cv2.GaussianBlur(solid.astype(np.float32), (0, 0), 0.5)
    box = np.ones((3, 3))
    alpha = np.clip(told * share + (1 - told) * crisp, cv2.erode(crisp, box), cv2.dilate(crisp, box))
    return np.where(inner > 0, 1, np.where(outer > 0, 0, alpha))


def near_mean(values: np.ndarray, where: np.ndarray, reach: int) -> np.ndarray:
    """(H, W, C) mean of the values (H, W, C) of nearby pixels of `where` (H, W), at ever larger distances until there
    is one. Smooth, so that a quarter of the pixels serves."""
    values, weight = np.atleast_3d(values), where.astype(np.float32)[..., None]
    size = values.shape[1::-1]
    small = tuple(max(1, side // 4) for side in size)
    both = cv2.resize(
        np.concatenate([values * weight, weight], -1).astype(np.float32), small, interpolation=cv2.INTER_AREA
    )
    total: np.ndarray = np.zeros_like(both)
    for step, side in enumerate((reach // 4, reach // 2, 2 * reach)):
        total = total + 100.0**-step * cv2.blur(both, (2 * side + 1, 2 * side + 1))
    mean = total[..., :-1] / np.maximum(total[..., -1:], 1e-8)
    return np.atleast_3d(cv2.resize(mean, size, interpolation=cv2.INTER_LINEAR))
