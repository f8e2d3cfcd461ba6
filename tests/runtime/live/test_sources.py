"""Cameras and clips, and what is neither."""

from __future__ import annotations

import os
import sys
from time import perf_counter

import numpy as np
import pytest

from gavatar_runtime.errors import MissingFile, UserError
from gavatar_runtime.live.sources import LivePictures

cv2 = pytest.importorskip("cv2", reason="reads cameras and clips")
os.environ.setdefault(
    "OPENCV_FFMPEG_LOGLEVEL", "-8"
)  # read once, by whatever opens a video first: here the tests' writer


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Ten frames at 50 a second, each as bright as its number."""
    path = tmp_path_factory.mktemp("clip") / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 50, (64, 48))
    for k in range(10):
        writer.write(np.full((48, 64, 3), 20 * k, np.uint8))
    writer.release()
    return path


def read_all(source):
    found = []
    while (read := source.read()) is not None:
        found.append((round(float(read[0].mean()) / 20), read[1]))
    return found


def test_a_clip_comes_as_fast_as_it_is_shown(clip):
    source = LivePictures(str(clip))
    start = perf_counter()
    found = read_all(source)
    assert perf_counter() - start >= 9 / 50 - 0.001
    assert source.name == "clip.avi"
    assert found[0] == (0, 0.0)
    numbers = [number for number, _ in found]
    assert numbers == sorted(set(numbers))
    assert len(numbers) + source.skipped == 10
    for number, time in found:
        assert time == pytest.approx(number / 50)
    source.close()


def test_overdue_frames_are_left_out(clip):
    source = LivePictures(str(clip))
    source.read()
    source._start -= 0.1  # five frames late
    image, time = source.read()
    assert round(image.mean() / 20) >= 5
    assert time == pytest.approx(round(image.mean() / 20) / 50)
    assert source.skipped >= 4
    source.close()


def test_a_clip_begins_again(clip):
    source = LivePictures(str(clip))
    read_all(source)
    assert source.again()
    assert source.read()[0].mean() < 5
    source.close()


def test_one_frame(tmp_path):
    path = tmp_path / "one.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    source = LivePictures(str(path))
    assert len(read_all(source)) == 1
    source.close()


@pytest.mark.parametrize("data", [b"", b"no video", b"\0" * 5000])
def test_no_video(tmp_path, data, capfd):
    path = tmp_path / "notes.mp4"
    path.write_bytes(data)
    with pytest.raises(UserError, match=r"notes\.mp4 cannot be read as a video") as caught:
        LivePictures(str(path))
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_no_file_and_no_camera(tmp_path, capfd):
    with pytest.raises(MissingFile, match=r"`drive=gone.mp4` is no camera's number and no file"):
        LivePictures("gone.mp4")
    with pytest.raises(MissingFile):
        LivePictures(str(tmp_path))
    with pytest.raises(UserError, match="camera 99 gives no picture"):
        LivePictures("99")
    assert capfd.readouterr() == ("", "")


def test_without_opencv(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(UserError, match=r"gavatar\[video\]"):
        LivePictures("0")
