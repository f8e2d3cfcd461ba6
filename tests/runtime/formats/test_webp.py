"""Lossless WebP, read back by libwebp through OpenCV and Pillow."""

from __future__ import annotations

import io

import numpy as np
import pytest

from gavatar_runtime.formats.webp import LARGEST, lossless_webp


def by_opencv(content: bytes) -> np.ndarray:
    cv2 = pytest.importorskip("cv2")
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)[..., [2, 1, 0, 3]]


def by_pillow(content: bytes) -> np.ndarray:
    return np.array(pytest.importorskip("PIL.Image").open(io.BytesIO(content)).convert("RGBA"))


@pytest.mark.parametrize("read", [by_opencv, by_pillow])
@pytest.mark.parametrize("size", [(1, 1), (1, 2), (3, 5), (64, 37), (1, LARGEST), (LARGEST, 1)])
def test_every_byte_comes_back(read, size):
    image = np.random.default_rng(0).integers(0, 256, (*size, 4)).astype(np.uint8)
    image[0, 0] = (1, 2, 3, 0)  # colours under no alpha too, which libwebp's own writer changes
    np.testing.assert_array_equal(read(lossless_webp(image)), image)


@pytest.mark.parametrize("value", [0, 255])
def test_one_colour_comes_back(value):
    image = np.full((7, 9, 4), value, np.uint8)
    np.testing.assert_array_equal(by_pillow(lossless_webp(image)), image)


@pytest.mark.parametrize("size", [(0, 1), (1, 0), (LARGEST + 1, 1), (1, LARGEST + 1)])
def test_a_size_that_the_format_lacks_is_refused(size):
    with pytest.raises(ValueError, match="a WebP image of"):
        lossless_webp(np.zeros((*size, 4), np.uint8))
