"""Images that are written without OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from gavatar_runtime.formats.png import png_bytes


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (31, 17), (512, 512), (2048, 1000)])
def test_a_png_holds_every_pixel(size):
    image = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
    for picture in (image, image[::-1, ::-1], np.zeros_like(image)):
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png_bytes(picture), np.uint8), 1)[..., ::-1], picture)
