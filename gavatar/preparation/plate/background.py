"""The room without the person: learnt from footage of a camera that stands still, or given as a picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from gavatar_runtime.errors import UserError

FRAMES = 32  # that a pixel's colour is the median of
FEW = 3  # least frames that show a pixel free of the person
MARGIN = 0.04  # of the person's longer side: how far a coarse mask may miss the person
LEAST_NOISE = 4.0  # grey levels, standard deviation: what a codec leaves of a still wall beside somebody who moves
MOST_NOISE = 14.0  # above that the picture does not explain what is seen beside the person
LEAST_KNOWN = 0.5  # of the surroundings of the person


@dataclasses.dataclass(frozen=True)
class Background:
    """picture: (H, W, 3) uint8 BGR. known: (H, W) uint8, 1 where it was seen. noise: grey levels, standard deviation of
    footage around it where nobody is."""

    picture: np.ndarray
    known: np.ndarray
    noise: float

    @property
    def explains(self) -> bool:
        """Whether footage beside the person looks like it."""
        return self.noise <= MOST_NOISE


def surroundings(mask: np.ndarray, margin: float = MARGIN) -> np.ndarray:
    """(H, W) uint8, 1 where a person may be whose coarse mask (H, W) uint8 this is."""
    _, _, w, h = cv2.boundingRect((mask > 20).astype(np.uint8))
    side = 2 * max(4, round(margin * max(w, h))) + 1
    return cv2.dilate((mask > 20).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))


def learn_background(images: Iterable[np.ndarray], masks: Iterable[np.ndarray]) -> Background | None:
    """The median of some frames' pixels where the person is not; None where too little of it was ever seen.

    images: (H, W, 3) uint8 BGR. masks: (H, W) uint8, coarse.
    """
    stack, near = [], []
    for image, mask in zip(images, masks, strict=True):
        stack.append(image)
        near.append(surroundings(mask))
    if len(stack) < 2 * FEW:
        return None
    covered = np.stack(near)  # (T, H, W)
    free = len(stack) - covered.sum(0, dtype=np.int32)
    known = (free >= FEW).astype(np.uint8)
    often = covered.any(0)
    if known[often].mean() < LEAST_KNOWN:
        return None
    picture = np.zeros_like(stack[0])
    middle = np.clip(free // 2, 0, len(stack) - 1)
    for channel in range(3):
        values = np.stack([image[..., channel] for image in stack])
        values[covered > 0] = 255  # sorted last
        values.sort(axis=0)
        picture[..., channel] = np.take_along_axis(values, middle[None], 0)[0]
    filled = cv2.inpaint(picture, 1 - known, 3, cv2.INPAINT_TELEA) if not known.all() else picture
    return Background(filled, known, _noise(filled, known, stack, covered))


def read_background(path: Path, size: tuple[int, int], images: Iterable[np.ndarray], masks: Iterable[np.ndarray]
                    ) -> Background:  # fmt: skip
    """A picture of the room without anybody. size: (width, height) of the footage. Raises UserError for one of another
    size, or that shows another room than the footage beside the person."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise UserError(f"{path} cannot be read as a picture: give one of the room without anybody in it")
    if picture.shape[1::-1] != size:
        raise UserError(f"{path} is {picture.shape[1]}x{picture.shape[0]} pixels, but the footage {size[0]}x{size[1]}")
    stack, covered = zip(*((i, surroundings(m)) for i, m in zip(images, masks, strict=True)), strict=True)
    known = np.ones(picture.shape[:2], np.uint8)
    found = Background(picture, known, _noise(picture, known, list(stack), np.stack(covered)))
    if not found.explains:
        raise UserError(
            f"{path} is not the background of this footage: beside the person pixels differ by {found.noise:.0f} grey "
            "levels; take it from the same place, with the same light and exposure"
        )
    return found


def _noise(picture: np.ndarray, known: np.ndarray, stack: list[np.ndarray], covered: np.ndarray) -> float:
    """Robust standard deviation of footage around the picture, of the pixels that somebody stands before at times."""
    about = (known > 0) & covered.any(0)
    off = [np.abs(image.astype(np.int16) - picture)[about & (near == 0)].reshape(-1)
              for image, near in zip(stack, covered, strict=True)]  # fmt: skip
    values = np.concatenate(off)
    return max(LEAST_NOISE, float(np.quantile(values, 0.75)) / 1.15) if len(values) else MOST_NOISE + 1
