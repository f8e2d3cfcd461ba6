"""Folders of frames and contact sheets: whole or not at all."""

from __future__ import annotations

import errno
import os

import cv2
import numpy as np
import pytest

from gavatar_runtime import native_library
from gavatar_runtime.errors import UserError
from gavatar_runtime.play.outputs import FrameFormat, open_output


@pytest.mark.parametrize("name", ["sheet.png", "frames"])
def test_a_disk_that_is_full_is_named_and_leaves_nothing(tmp_path, monkeypatch, name):
    def write(path, image):
        path.write_bytes(b"half of it")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for module in ("frame_folder", "contact_sheet"):
        monkeypatch.setattr(f"gavatar_runtime.play.outputs.{module}.write_png", write)
    output = open_output(tmp_path / name, FrameFormat(1, 2, 2))
    put = output.add if name == "frames" else lambda image: (output.add(image), output.close())
    with pytest.raises(UserError, match=f"{name}.* could not be written: {os.strerror(errno.ENOSPC)}"):
        put(np.zeros((2, 2, 3), np.uint8))
    output.discard()
    assert list(tmp_path.iterdir()) == []


def test_frames_replace_earlier_frames_and_nothing_else(tmp_path):
    folder = tmp_path / "f"
    for count in (3, 1):
        output = open_output(folder, FrameFormat(1, 2, 2))
        for _ in range(count):
            output.add(np.zeros((2, 2, 3), np.uint8))
        output.close()
        assert len(list(folder.iterdir())) == count
    (folder / "thesis.txt").write_text("keep me")
    with pytest.raises(UserError, match=r"thesis\.txt.*another folder"):
        open_output(folder, FrameFormat(1, 2, 2))
    assert (folder / "thesis.txt").read_text() == "keep me"


@pytest.mark.parametrize(("count", "shape"), [(1, (3, 2)), (3, (3, 6)), (5, (6, 8)), (12, (9, 8)), (100, (9, 8))])
def test_a_contact_sheet_holds_up_to_twelve_frames_in_reading_order(tmp_path, count, shape):
    output = open_output(tmp_path / "a.png", FrameFormat(1, 2, 3, (0, 0, 1)))
    chosen = output.choose(count)
    assert len(chosen) == min(count, 12)
    assert chosen == sorted(set(chosen))
    assert chosen[0] == 0
    for frame in chosen:
        output.add(np.full((3, 2, 3), frame, np.uint8))
    output.close()
    sheet = cv2.imread(str(tmp_path / "a.png"))[..., ::-1]
    assert sheet.shape[:2] == shape
    for i, frame in enumerate(chosen):
        row, column = divmod(i, 4)
        assert (sheet[3 * row, 2 * column] == frame).all()
    if count == 5:
        assert sheet[-1, -1].tolist() == [0, 0, 255]  # the rest is background


def test_a_place_that_cannot_be_written_is_known_before_rendering(tmp_path):
    (tmp_path / "file").write_text("")
    for name in ("a.mp4", "a.png", "frames/"):
        with pytest.raises(UserError, match="cannot be written"):
            open_output(f"{tmp_path}/file/{name}", FrameFormat(1, 16, 16))


# without OpenCV


@pytest.mark.usefixtures("no_opencv", "no_ffmpeg")
def test_without_opencv_and_ffmpeg_a_video_is_refused_with_both_remedies_and_the_rest_is_written(tmp_path):
    frames = FrameFormat(1, 16, 16)
    with pytest.raises(UserError, match=r"a\.mp4: .*pip install 'gavatar\[video\]'.*ffmpeg on the PATH.*\.png"):
        open_output(tmp_path / "a.mp4", frames)
    assert list(tmp_path.iterdir()) == []
    names = ["frames", "sheet.png"] + ["sheet.jpg"] * native_library.available()[0]
    for name in names:
        output = open_output(tmp_path / name, frames)
        output.add(np.full((16, 16, 3), 7, np.uint8))
        output.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)


def test_without_the_kernel_a_jpg_is_refused_with_the_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(native_library, "available", lambda: (False, "it was not compiled"))
    with pytest.raises(UserError, match=r"a\.jpg: .*native kernel \(it was not compiled\).*\.png"):
        open_output(tmp_path / "a.jpg", FrameFormat(1, 16, 16))
    assert list(tmp_path.iterdir()) == []


# names of the frames, and options of a sheet


def add(output, count):
    for level in range(count):
        output.add(np.full((2, 2, 3), level, np.uint8))
    output.close()
    output.discard()


@pytest.mark.parametrize(
    ("name", "files"),
    [("%06d.png", ["000000.png", "000001.png"]), ("walk_%d.png", ["walk_0.png", "walk_1.png"]),
     ("50%_%02d.png", ["50%_00.png", "50%_01.png"])],
)  # fmt: skip
def test_frames_may_be_named(tmp_path, name, files):
    add(open_output(tmp_path / "f" / name, FrameFormat(1, 2, 2)), 2)
    assert sorted(path.name for path in (tmp_path / "f").iterdir()) == files
    assert (cv2.imread(str(tmp_path / "f" / files[1])) == 1).all()
    add(open_output(tmp_path / "f" / name, FrameFormat(1, 2, 2)), 1)  # and replaced by their name
    assert [path.name for path in (tmp_path / "f").iterdir()] == files[:1]
    with pytest.raises(UserError, match="no frame of an earlier run"):
        open_output(tmp_path / "f" / "other_%06d.png", FrameFormat(1, 2, 2))


def test_a_name_with_two_numbers_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"one number in their name, as in %06d\.png"):
        open_output(tmp_path / "f" / "%d_%d.png", FrameFormat(1, 2, 2))


@pytest.mark.parametrize("name", ["%06d.png", ".", "../here/%d.png"])
def test_the_present_folder_is_never_replaced(tmp_path, monkeypatch, name):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(UserError, match="folder of their own"):
        open_output(name, FrameFormat(1, 2, 2))
    assert (tmp_path / "here").is_dir()


def test_a_sheet_of_other_columns_and_frames(tmp_path):
    frames, options = FrameFormat(1, 2, 2), {"shown": 3, "columns": 1}
    output = open_output(tmp_path / "a.png", frames, options=options)
    assert output.choose(9) == [0, 3, 6]
    add(output, 3)
    assert cv2.imread(str(tmp_path / "a.png")).shape == (6, 2, 3)
    with pytest.raises(ValueError, match=r"`output\.shown=0`: give a whole number from 1 up"):
        open_output(tmp_path / "a.png", frames, options={"shown": 0})
    with pytest.raises(UserError, match="output 'sheet' has no option 'rows'"):
        open_output(tmp_path / "a.png", frames, options={"rows": 3})
