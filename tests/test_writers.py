"""What the player writes: videos, folders of frames, contact sheets; whole or not at all."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from video_frames import frames_of

from gavatar_runtime.errors import UserError
from gavatar_runtime.writers import open_writer, to_bytes


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


def test_bytes_are_rounded_and_clipped():
    color = np.array([[[0, 0.5, 1]], [[-1, 2, np.nan]], [[0.499 / 255, 0.501 / 255, np.inf]]])
    assert to_bytes(color).tolist() == [[[0, 128, 255]], [[0, 255, 0]], [[0, 1, 255]]]
