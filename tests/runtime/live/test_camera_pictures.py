"""What a page's camera may send."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.errors import WrongValue
from gavatar_runtime.live.camera_pictures import MOST_BYTES, decoded, jpeg_size

cv2 = pytest.importorskip("cv2", reason="writes the pictures")


def jpeg(height=30, width=40, seed=0) -> bytes:
    image = np.random.default_rng(seed).integers(0, 255, (height, width, 3), np.uint8)
    return cv2.imencode(".jpg", image)[1].tobytes()


def test_a_picture():
    assert jpeg_size(jpeg()) == (40, 30)
    assert decoded(jpeg()).shape == (30, 40, 3)
    assert decoded(jpeg(1, 1)).shape == (1, 1, 3)


def declared(width: int, height: int) -> bytes:
    """A small JPEG that says it is that large."""
    data = bytearray(jpeg())
    place = data.index(b"\xff\xc0")
    data[place + 5 : place + 9] = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    return bytes(data)


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff", b"\xff\xd8", b"\xff\xd8\xff", b"\xff\xd8\xff\xc0\x00\x11\x08", b"GIF89a",
     b"\xff\xd8" + b"\xff" * 999, b"\xff\xd8\xff\xe0\x00\x00" * 9, jpeg()[:40], declared(65535, 65535),
     declared(2049, 10), declared(0, 10), b"\x89PNG\r\n\x1a\n" + bytes(100), b"\xff\xd8" + bytes(MOST_BYTES)],
)  # fmt: skip
def test_what_is_no_picture_is_one_sentence(data):
    with pytest.raises(WrongValue) as caught:
        decoded(data)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("the camera's picture")


def test_damage_anywhere_is_a_picture_or_a_sentence():
    whole = jpeg()
    rng = np.random.default_rng(1)
    for _ in range(300):
        data = bytearray(whole[: rng.integers(2, len(whole) + 1)])
        for place in rng.integers(0, len(data), 3):
            data[place] = rng.integers(256)
        try:
            image = decoded(bytes(data))
        except WrongValue:
            continue
        assert image.dtype == np.uint8
        assert image.ndim == 3
        assert max(image.shape) <= 2048
