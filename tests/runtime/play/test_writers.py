"""What the player writes: videos, folders of frames, contact sheets; whole or not at all."""

from __future__ import annotations

import errno
import itertools
import json
import os
import sys

import cv2
import numpy as np
import pytest
from video_frames import frames_of

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.png import png_bytes
from gavatar_runtime.play import video
from gavatar_runtime.play.writers import open_writer
from gavatar_runtime.render.pixels import to_bytes


@pytest.fixture
def no_opencv(monkeypatch):
    """The tests may read images with OpenCV, the code may not import it."""
    monkeypatch.setitem(sys.modules, "cv2", None)


@pytest.fixture
def no_ffmpeg(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))


@pytest.fixture(params=["opencv", "ffmpeg"])
def encoder(request):
    """Each of the encoders in turn, as the one that is there."""
    if request.param == "ffmpeg":
        request.getfixturevalue("no_opencv")
        if video.ffmpeg_codec() is None:
            pytest.skip("there is no program ffmpeg on the PATH")
    return request.param


@pytest.mark.usefixtures("encoder")
@pytest.mark.parametrize("size", [(1, 1), (2, 2), (3, 5), (16, 16), (17, 31), (64, 33)])
@pytest.mark.parametrize("count", [1, 4])
def test_a_video_of_any_size_plays_back_all_its_frames(tmp_path, size, count):
    path = tmp_path / "a.mp4"
    writer = open_writer(path, width=size[0], height=size[1], fps=12.5, background=(0, 0, 0))
    image = np.full((size[1], size[0], 3), (200, 120, 40), np.uint8)
    for _ in writer.choose(count):
        writer.add(image)
    assert not path.exists()
    writer.close()
    writer.discard()
    frames = frames_of(path)
    assert len(frames) == count
    assert frames[0].shape == (size[1] + size[1] % 2, size[0] + size[0] % 2, 3)
    if min(size) >= 16:
        # 6 of 255: what the codec makes of a flat colour
        np.testing.assert_allclose(frames[0][2:10, 2:10].mean((0, 1)), (200, 120, 40), atol=6)
    assert list(tmp_path.iterdir()) == [path]


def test_a_video_without_frames_is_not_written(tmp_path):
    writer = open_writer(tmp_path / "a.mp4", width=16, height=16, fps=30)
    with pytest.raises(UserError, match=r"a\.mp4 could not be written whole"):
        writer.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["sheet.png", "frames"])
def test_a_disk_that_is_full_is_named_and_leaves_nothing(tmp_path, monkeypatch, name):
    def write(path, image):
        path.write_bytes(b"half of it")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("gavatar_runtime.play.writers.write_png", write)
    writer = open_writer(tmp_path / name, width=2, height=2, fps=1)
    put = writer.add if name == "frames" else lambda image: (writer.add(image), writer.close())
    with pytest.raises(UserError, match=f"{name}.* could not be written: {os.strerror(errno.ENOSPC)}"):
        put(np.zeros((2, 2, 3), np.uint8))
    writer.discard()
    assert list(tmp_path.iterdir()) == []


def test_frames_replace_earlier_frames_and_nothing_else(tmp_path):
    folder = tmp_path / "f"
    for count in (3, 1):
        writer = open_writer(folder, width=2, height=2, fps=1)
        for _ in range(count):
            writer.add(np.zeros((2, 2, 3), np.uint8))
        writer.close()
        assert len(list(folder.iterdir())) == count
    (folder / "thesis.txt").write_text("keep me")
    with pytest.raises(UserError, match=r"thesis\.txt.*another folder"):
        open_writer(folder, width=2, height=2, fps=1)
    assert (folder / "thesis.txt").read_text() == "keep me"


@pytest.mark.parametrize(("count", "shape"), [(1, (3, 2)), (3, (3, 6)), (5, (6, 8)), (12, (9, 8)), (100, (9, 8))])
def test_a_contact_sheet_holds_up_to_twelve_frames_in_reading_order(tmp_path, count, shape):
    writer = open_writer(tmp_path / "a.png", width=2, height=3, fps=1, background=(0, 0, 1))
    chosen = writer.choose(count)
    assert len(chosen) == min(count, 12)
    assert chosen == sorted(set(chosen))
    assert chosen[0] == 0
    for frame in chosen:
        writer.add(np.full((3, 2, 3), frame, np.uint8))
    writer.close()
    sheet = cv2.imread(str(tmp_path / "a.png"))[..., ::-1]
    assert sheet.shape[:2] == shape
    for i, frame in enumerate(chosen):
        row, column = divmod(i, 4)
        assert (sheet[3 * row, 2 * column] == frame).all()
    if count == 5:
        assert sheet[-1, -1].tolist() == [0, 0, 255]  # the rest is background


def test_the_writer_is_chosen_by_the_name(tmp_path):
    size = {"width": 16, "height": 16, "fps": 1}
    (tmp_path / "there.mp4").mkdir()
    kinds = {"a.mp4": "VideoFile", "a.MP4": "VideoFile", "a.png": "ContactSheet", "a.jpg": "ContactSheet",
             "a": "FrameFolder", "a.mp4/": "FrameFolder", "there.mp4": "FrameFolder"}  # fmt: skip
    for name, kind in kinds.items():
        writer = open_writer(f"{tmp_path}/{name}", **size)
        assert type(writer).__name__ == kind
        writer.discard()
    with pytest.raises(UserError, match=r"cannot write .*a\.mp5.*did you mean '\.mp4'"):
        open_writer(tmp_path / "a.mp5", **size)


def test_a_place_that_cannot_be_written_is_known_before_rendering(tmp_path):
    (tmp_path / "file").write_text("")
    for name in ("a.mp4", "a.png", "frames/"):
        with pytest.raises(UserError, match="cannot be written"):
            open_writer(f"{tmp_path}/file/{name}", width=16, height=16, fps=1)


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (31, 17), (512, 512), (2048, 1000)])
def test_a_png_holds_every_pixel(size):
    image = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
    for picture in (image, image[::-1, ::-1], np.zeros_like(image)):
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png_bytes(picture), np.uint8), 1)[..., ::-1], picture)


# without OpenCV


@pytest.mark.usefixtures("no_opencv", "no_ffmpeg")
def test_without_opencv_and_ffmpeg_a_video_is_refused_with_both_remedies_and_the_rest_is_written(tmp_path):
    size = {"width": 16, "height": 16, "fps": 1}
    with pytest.raises(UserError, match=r"a\.mp4: .*pip install 'gavatar\[video\]'.*ffmpeg on the PATH.*\.png"):
        open_writer(tmp_path / "a.mp4", **size)
    with pytest.raises(UserError, match=r"a\.jpg: .*pip install 'gavatar\[video\]'.*\.png"):
        open_writer(tmp_path / "a.jpg", **size)
    assert list(tmp_path.iterdir()) == []
    for name in ("frames", "sheet.png"):
        writer = open_writer(tmp_path / name, **size)
        writer.add(np.full((16, 16, 3), 7, np.uint8))
        writer.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frames", "sheet.png"]


FAKE_FFMPEG = """#!{python}
import json, sys
if "-encoders" in sys.argv:
    print(" V....D {codec}  a codec\\n A....D aac  of sound")
    sys.exit()
if {fails}:
    sys.stdin.buffer.read(100)
    sys.exit("some banner\\nNo space left on device")
data = sys.stdin.buffer.read()
open(sys.argv[-1], "w").write(json.dumps([sys.argv[1:-1], len(data), list(data[:6]), list(data[-6:])]))
"""


@pytest.fixture
def fake_ffmpeg(monkeypatch, tmp_path_factory, no_opencv):
    """`fake_ffmpeg(codec)` puts a program on the PATH that has that codec and writes down what it was given."""

    def install(codec="libx264", fails=False):
        folder = tmp_path_factory.mktemp("bin")
        program = folder / "ffmpeg"
        program.write_text(FAKE_FFMPEG.format(python=sys.executable, codec=codec, fails=fails))
        program.chmod(0o755)
        monkeypatch.setenv("PATH", str(folder))

    return install


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a script with a shebang")
@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
def test_ffmpeg_is_given_the_frames_and_the_best_codec_it_has(fake_ffmpeg, tmp_path, codec):
    fake_ffmpeg(codec)
    writer = open_writer(tmp_path / "a.mp4", width=3, height=2, fps=29.97, background=(0, 0, 1))
    for level in (10, 20):
        writer.add(np.full((2, 3, 3), level, np.uint8))
    writer.close()
    writer.discard()
    arguments, count, first, last = json.loads((tmp_path / "a.mp4").read_text())
    assert (count, first, last) == (2 * 2 * 4 * 3, [10] * 6, [20, 20, 20, 0, 0, 255])  # padded to an even width
    options = dict(itertools.pairwise(arguments))
    assert {k: options[k] for k in ("-s", "-r", "-i", "-c:v")} == {
        "-s": "4x2", "-r": "29.970000", "-i": "pipe:0", "-c:v": codec
    }  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a script with a shebang")
def test_an_ffmpeg_that_gives_up_is_quoted_and_leaves_nothing(fake_ffmpeg, tmp_path):
    fake_ffmpeg(fails=True)
    writer = open_writer(tmp_path / "a.mp4", width=256, height=1024, fps=30)
    image = np.zeros((1024, 256, 3), np.uint8)  # more than a pipe holds, so that the break shows at once
    with pytest.raises(UserError, match=r"a\.mp4 could not be written: ffmpeg says: No space left on device"):
        writer.add(image)
    writer.discard()
    assert list(tmp_path.iterdir()) == []
    writer = open_writer(tmp_path / "a.mp4", width=2, height=2, fps=30)
    writer.add(np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(UserError, match="could not be written whole: ffmpeg says: No space left on device"):
        writer.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a script with a shebang")
@pytest.mark.usefixtures("no_opencv")
def test_an_ffmpeg_without_a_codec_or_that_does_not_run_is_none(fake_ffmpeg, tmp_path):
    fake_ffmpeg("vp9")
    assert video.find_encoder() is None
    fake_ffmpeg("libx264", fails="this is no Python")
    assert video.find_encoder() is None
    fake_ffmpeg("libx264")
    assert video.find_encoder() is video.Ffmpeg


def test_bytes_are_rounded_and_clipped():
    color = np.array([[[0, 0.5, 1]], [[-1, 2, np.nan]], [[0.499 / 255, 0.501 / 255, np.inf]]])
    assert to_bytes(color).tolist() == [[[0, 128, 255]], [[0, 255, 0]], [[0, 1, 255]]]
