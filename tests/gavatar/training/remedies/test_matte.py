"""A matte: the border of a mask found anew in the footage's colours."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar.training.remedies.matte import matted


def wide(side: int = 96, radius: float = 30, by: float = 3):
    """A red disc before a wall of two greys, its true alpha, and a mask cut too wide."""
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    true = np.clip(radius - np.hypot(x, y) + 0.5, 0, 1).astype(np.float32)
    wall = np.where(x < 0, 0.1, 0.3)[..., None] * np.ones(3)
    person = np.array([0.8, 0.3, 0.25]) + 0.1 * np.sin(x / 4)[..., None]
    image = (true[..., None] * person + (1 - true[..., None]) * wall).astype(np.float32)
    return image, true, (np.hypot(x, y) < radius + by).astype(np.float32)


def test_a_matte_finds_the_border_that_the_mask_missed():
    image, true, mask = wide()
    color, alpha = matted(image, mask, 6)
    assert np.abs(mask - true).mean() > 10 * np.abs(alpha - true).mean()
    assert np.abs(alpha - true).max() < 0.5  # the pixels that are a mixture, to half of one
    assert (alpha[mask == 0] == 0).all()
    assert (color <= alpha[..., None] + 1e-6).all()
    rim = (mask > 0) & (true == 0)
    assert color[rim].max() < 0.1  # no wall is left in it: as colour of the person it would be a dark rim


def test_a_matte_leaves_what_colours_do_not_tell():
    image, _, mask = wide()
    plain = np.full_like(image, 0.5)
    color, alpha = matted(plain, mask, 6)
    np.testing.assert_array_equal(alpha, mask)
    np.testing.assert_allclose(color, plain * mask[..., None])


@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_a_matte_of_a_mask_without_a_border_changes_nothing(fill):
    image, mask = np.random.default_rng(0).random((6, 5, 3), np.float32), np.full((6, 5), fill, np.float32)
    color, alpha = matted(image, mask, 3)
    np.testing.assert_array_equal(alpha, mask)
    np.testing.assert_array_equal(color, image * fill)
