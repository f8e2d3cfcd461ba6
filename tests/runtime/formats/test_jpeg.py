"""JPEG images: what somebody else's decoder makes of them, beside plain NumPy and beside somebody else's encoder."""

from __future__ import annotations

import numpy as np
import pytest
from plain_jpeg import through_jpeg

from gavatar_runtime import native_library
from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.jpeg import LARGEST, jpeg
from gavatar_runtime.render.pixels import to_bytes

cv2 = pytest.importorskip("cv2", reason="reads the images")
pytestmark = pytest.mark.skipif(not native_library.available()[0], reason="the kernel writes them")

QUALITIES = (1, 25, 50, 75, 90, 100)


@pytest.fixture(params=native_library.instruction_sets() if native_library.available()[0] else [])
def instruction_set(request):
    before = native_library.instruction_set()
    native_library.use_instruction_set(request.param)
    yield request.param
    native_library.use_instruction_set(before)


def decoded(data: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]


def picture(height: int, width: int) -> np.ndarray:
    """Slopes, an edge, a flat part and noise."""
    y, x = np.mgrid[:height, :width] / max(height, width)
    image = np.stack([x, y, (x + y) / 2], -1)
    image[np.hypot(x - 0.4, y - 0.4) < 0.2] = (0.9, 0.1, 0.1)
    noise = np.random.default_rng(0).normal(0, 0.1, image.shape)
    return to_bytes(np.where(x[..., None] > 0.7, image + noise, image).astype(np.float32))


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / max(np.square(a.astype(float) - b).mean(), 1e-9)))


@pytest.mark.parametrize("size", [(1, 1), (7, 9), (8, 8), (17, 129), (200, 133)])
@pytest.mark.usefixtures("instruction_set")
def test_a_decoder_reads_what_plain_arithmetic_keeps(size, capfd):
    image = picture(*size)
    for quality in QUALITIES:
        error = np.abs(decoded(jpeg(image, quality)) - through_jpeg(image, quality))
        # The decoder's integers: 1.9 levels at most were seen, and 3.3 where a coefficient on the edge between two
        # steps went the other way.
        assert np.quantile(error, 0.99) <= 2.5, quality
        assert error.mean() < 0.6, quality
    assert "orrupt" not in capfd.readouterr().err  # libjpeg tells so, and goes on


@pytest.mark.parametrize("quality", QUALITIES)
def test_images_are_as_good_and_as_small_as_opencv_writes_them(quality):
    image = picture(301, 222)
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    theirs = cv2.imencode(".jpg", image[:, :, ::-1], flags)[1].tobytes()
    ours = jpeg(image, quality)
    assert psnr(decoded(ours), image) > psnr(decoded(theirs), image) - 0.02
    markers = 6 + 4 * -(-301 // 8)  # that let threads share an image: two bytes a line, and filling up
    assert len(ours) < 1.005 * len(theirs) + markers


@pytest.mark.parametrize("color", [(0, 0, 0), (255, 255, 255), (255, 0, 0), (0, 255, 0), (0, 0, 255), (17, 130, 201)])
@pytest.mark.parametrize("size", [(1, 1), (40, 33)])
def test_one_colour_stays(color, size):
    image = np.empty((*size, 3), np.uint8)
    image[:] = color
    assert np.abs(decoded(jpeg(image, 100)).astype(int) - image).max() <= 1
    assert np.ptp(decoded(jpeg(image, 1)).reshape(-1, 3), axis=0).max() == 0


@pytest.mark.usefixtures("instruction_set")
def test_the_hardest_images_fit_and_are_read(capfd):
    """Black and white by turns make the largest coefficients that there are, noise the most codes."""
    board = np.repeat(np.indices((64, 64)).sum(0).astype(np.uint8) % 2 * np.uint8(255), 3).reshape(64, 64, 3)
    noise = np.random.default_rng(0).choice(np.array([0, 255], np.uint8), (64, 200, 3))
    for image in (board, noise):
        for quality in (1, 100):
            data = jpeg(image, quality)
            assert len(data) <= native_library.library().gv_jpeg_most(*image.shape[:2])
            assert decoded(data).shape == image.shape
        assert psnr(decoded(jpeg(image, 100)), image) > 38  # colours of noise are outside of what YCbCr rounds well
    assert "orrupt" not in capfd.readouterr().err


def test_pixels_that_are_no_number_become_black_before():
    with np.errstate(invalid="ignore"):
        image = to_bytes(np.full((9, 9, 3), np.nan, np.float32))
    assert decoded(jpeg(image, 90)).max() == image.max()


def test_threads_and_layouts_change_nothing():
    image = picture(120, 90)
    before = native_library.threads()
    data = []
    for threads in (1, 3):
        native_library.set_threads(threads)
        data.append(jpeg(image, 80))
    native_library.set_threads(before)
    assert data[0] == data[1]
    assert jpeg(np.asfortranarray(image), 80) == jpeg(image[:, ::-1][:, ::-1], 80) == data[0]


def test_what_is_no_image_is_refused():
    image = np.zeros((2, 2, 3), np.uint8)
    for quality in (0, 101):
        with pytest.raises(UserError, match=f"quality={quality}.*from 1 to 100"):
            jpeg(image, quality)
    for wrong in (image[..., 0], image[..., :2], image.astype(np.float32), image[:0], image[:, :0]):
        with pytest.raises(ValueError, match="JPEG image of"):
            jpeg(wrong)
    with pytest.raises(ValueError, match="65536 pixels"):
        jpeg(np.zeros((LARGEST + 1, 1, 3), np.uint8))
    assert native_library.library().gv_jpeg_most(0, 5) == -2
