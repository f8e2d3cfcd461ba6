"""Masks too wide or too narrow are told from the pictures' own border; masks that fit, and what tells nothing, are left
alone."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gavatar.training.remedies.mask_border import mask_border
from gavatar.training.remedies.matte import matted

SIDE, RADIUS = 256, 80


def filmed(off: float, views: int = 3, side: int = SIDE):
    """A capture of a disc before a wall, both uneven and noisy, whose masks are `off` pixels too wide."""
    pictures = []
    for seed in range(views):
        random = np.random.default_rng(seed)
        y, x = np.mgrid[:side, :side] - (side - 1) / 2
        distance = np.hypot(x + 3 * seed, y)
        true = np.clip(RADIUS - distance + 0.5, 0, 1)[..., None]
        wall = np.where(x < 0, 0.1, 0.3)[..., None] * np.ones(3)
        cloth = np.array([0.8, 0.3, 0.25]) + 0.1 * np.sin(x / 4)[..., None]
        image = true * cloth + (1 - true) * wall + random.normal(0, 0.02, (side, side, 3))
        mask = np.clip(RADIUS + off - distance + 0.5, 0, 1)
        pictures.append((np.uint8(255 * np.clip(image[..., ::-1], 0, 1)), np.uint8(255 * mask)))
    return SimpleNamespace(read=lambda view: pictures[view]), list(range(views))


@pytest.mark.parametrize(("off", "mending"), [(3, 5), (-3, -5), (2, 4), (-2, -4), (0, 0), (0.4, 0), (-0.4, 0)])
@pytest.mark.parametrize("views", [1, 3])
def test_the_width_that_was_planted_is_found(off, mending, views):
    border = mask_border(*filmed(off, views))
    assert border.pixels == pytest.approx(off, abs=0.5)  # masks are cut at whole pixels
    assert border.mending == mending


def test_what_is_negligible_grows_with_the_picture():
    (capture, views), (large, _) = filmed(0.9), filmed(0.9, side=1024)
    assert mask_border(capture, views).mending == 3
    assert mask_border(large, views).mending == 0  # 0.9 of 1024 pixels


def test_colours_that_are_alike_tell_nothing():
    capture, views = filmed(3)
    grey = SimpleNamespace(read=lambda view: (np.full((SIDE, SIDE, 3), 90, np.uint8), capture.read(view)[1]))
    assert mask_border(grey, views) is None


@pytest.mark.parametrize("fill", [0, 255])
def test_masks_without_a_border_tell_nothing(fill):
    image, mask = np.full((64, 64, 3), 255, np.uint8), np.full((64, 64), fill, np.uint8)
    assert mask_border(SimpleNamespace(read=lambda view: (image, mask)), [0]) is None


def test_views_without_a_person_do_not_count():
    (capture, _), empty = filmed(3), (np.zeros((SIDE, SIDE, 3), np.uint8), np.zeros((SIDE, SIDE), np.uint8))
    both = SimpleNamespace(read=lambda view: empty if view else capture.read(0))
    assert mask_border(both, [0, 1, 2]).mending == 5


@pytest.mark.parametrize("off", [3, -3])
def test_what_is_found_mends_the_mask(off):
    capture, views = filmed(off, 1)
    true = filmed(0, 1)[0].read(0)[1] / 255
    image, mask = capture.read(0)
    image, mask = image[..., ::-1].astype(np.float32) / 255, mask.astype(np.float32) / 255
    color, alpha = matted(image, mask, mask_border(capture, views).mending)
    assert np.abs(alpha - true).mean() < np.abs(mask - true).mean() / 5
    certain = cv2.erode(np.float32(true > 0.99), np.ones((15, 15))) > 0
    np.testing.assert_array_equal(alpha[certain], 1)
    assert (color <= alpha[..., None] + 1e-6).all()


def test_a_narrow_mask_of_nothing_stays_empty():
    image, mask = np.random.default_rng(0).random((6, 5, 3), np.float32), np.zeros((6, 5), np.float32)
    np.testing.assert_array_equal(matted(image, mask, -3)[1], mask)
