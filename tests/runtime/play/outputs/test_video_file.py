"""Videos, by OpenCV or a program ffmpeg: whole or not at all."""

from __future__ import annotations

import itertools
import json
import sys

import numpy as np
import pytest
from video_frames import frames_of

from gavatar_runtime.errors import UserError
from gavatar_runtime.play.outputs import FrameFormat, open_output, video_encoder


@pytest.fixture(params=["opencv", "ffmpeg"])
def encoder(request):
    """Each of the encoders in turn, as the one that is there."""
    if request.param == "ffmpeg":
        request.getfixturevalue("no_opencv")
        if video_encoder.ffmpeg_codec() is None:
            pytest.skip("there is no program ffmpeg on the PATH")
    return request.param


@pytest.mark.usefixtures("encoder")
@pytest.mark.parametrize("size", [(1, 1), (2, 2), (3, 5), (16, 16), (17, 31), (64, 33)])
@pytest.mark.parametrize("count", [1, 4])
def test_a_video_of_any_size_plays_back_all_its_frames(tmp_path, size, count):
    path = tmp_path / "a.mp4"
    output = open_output(path, FrameFormat(12.5, *size, (0, 0, 0)))
    image = np.full((size[1], size[0], 3), (200, 120, 40), np.uint8)
    for _ in output.choose(count):
        output.add(image)
    assert not path.exists()
    output.close()
    output.discard()
    frames = frames_of(path)
    assert len(frames) == count
    assert frames[0].shape == (size[1] + size[1] % 2, size[0] + size[0] % 2, 3)
    if min(size) >= 16:
        # 6 of 255: what the codec makes of a flat colour
        np.testing.assert_allclose(frames[0][2:10, 2:10].mean((0, 1)), (200, 120, 40), atol=6)
    assert list(tmp_path.iterdir()) == [path]


def test_a_video_without_frames_is_not_written(tmp_path):
    output = open_output(tmp_path / "a.mp4", FrameFormat(30, 16, 16))
    with pytest.raises(UserError, match=r"a\.mp4 could not be written whole"):
        output.close()
    assert list(tmp_path.iterdir()) == []


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
    output = open_output(tmp_path / "a.mp4", FrameFormat(29.97, 3, 2, (0, 0, 1)))
    for level in (10, 20):
        output.add(np.full((2, 3, 3), level, np.uint8))
    output.close()
    output.discard()
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
    output = open_output(tmp_path / "a.mp4", FrameFormat(30, 256, 1024))
    image = np.zeros((1024, 256, 3), np.uint8)  # more than a pipe holds, so that the break shows at once
    with pytest.raises(UserError, match=r"a\.mp4 could not be written: ffmpeg says: No space left on device"):
        output.add(image)
    output.discard()
    assert list(tmp_path.iterdir()) == []
    output = open_output(tmp_path / "a.mp4", FrameFormat(30, 2, 2))
    output.add(np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(UserError, match="could not be written whole: ffmpeg says: No space left on device"):
        output.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a script with a shebang")
@pytest.mark.usefixtures("no_opencv")
def test_an_ffmpeg_without_a_codec_or_that_does_not_run_is_none(fake_ffmpeg, tmp_path):
    fake_ffmpeg("vp9")
    assert video_encoder.find_encoder() is None
    fake_ffmpeg("libx264", fails="this is no Python")
    assert video_encoder.find_encoder() is None
    fake_ffmpeg("libx264")
    assert video_encoder.find_encoder() is video_encoder.Ffmpeg
