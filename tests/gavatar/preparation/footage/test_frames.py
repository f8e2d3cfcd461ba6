"""Frames of any kind of pixels and orientation; sizes that do not agree."""

import struct

import cv2
import numpy as np
import pytest
from footage_folder import footage_folder, frame

from gavatar.preparation.detect import Detector
from gavatar.preparation.footage.pictures import read_frame
from gavatar.preparation.footage_source import SourceOptions, open_source
from gavatar_runtime.errors import UserError

NAMES = [f"{t}.png" for t in range(3)]


def test_grey_and_16_bit_and_transparent_frames(tmp_path):
    grey = cv2.cvtColor(frame(0), cv2.COLOR_BGR2GRAY)
    for name, image, wanted in (
        ("grey", grey, np.dstack([grey] * 3)),
        ("deep", frame(0).astype(np.uint16) * 257, frame(0)),
        ("clear", np.dstack([frame(0), np.full(grey.shape, 90, np.uint8)]), frame(0)),
    ):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
        np.testing.assert_array_equal(read_frame(tmp_path / f"{name}.png"), wanted)


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_frames_are_turned_as_exif_says(tmp_path, orientation, turns):
    """After colmap/colmap #1456 and cdcseacave/openMVS #777."""
    stored = frame(0)[:, 8:56]
    jpeg = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    tiff = b"MM\0*\0\0\0\x08\0\x01" + struct.pack(">HHIHH", 0x0112, 3, 1, orientation, 0) + b"\0\0\0\0"
    exif = b"Exif\0\0" + tiff
    (tmp_path / "a.jpg").write_bytes(jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:])
    found = read_frame(tmp_path / "a.jpg")
    wanted = np.rot90(stored, turns)
    assert found.shape == wanted.shape
    assert np.abs(found.astype(int) - wanted).mean() < 4  # what JPEG loses


def test_masks_that_lie_otherwise_than_their_frames(tmp_path):
    folder = footage_folder(tmp_path / "f", NAMES, NAMES, lambda m, image: np.ascontiguousarray(m[:, 8:56].T))
    for t, name in enumerate(NAMES):
        cv2.imwrite(str(folder / "frames" / name), frame(t)[:, 8:56])
    with pytest.raises(UserError, match=r"is 64x48 pixels, but camera 'cam0' filmed 48x64, turned"):
        list(open_source(folder).footage[0].masks())


@pytest.mark.parametrize("given", [True, False])
def test_frames_of_differing_size_are_refused_before_anything_is_fitted(tmp_path, given):
    folder = footage_folder(tmp_path / "f", NAMES, NAMES)
    cv2.imwrite(str(folder / "frames" / NAMES[2]), frame(2)[:40])
    options = SourceOptions(fps=10.0)
    if not given:
        (folder / "landmarks.npz").unlink()
        for path in (folder / "masks").iterdir():
            path.unlink()
        (folder / "masks").rmdir()
        options = SourceOptions(fps=10.0, detector=Detector(tmp_path / "work", progress=False))
    with pytest.raises(UserError, match=r"2\.png is 64x40 pixels, but 0\.png is 64x64: frames of one camera"):
        open_source(folder, options)


def test_an_empty_folder_and_one_frame(tmp_path):
    (tmp_path / "none" / "frames").mkdir(parents=True)
    with pytest.raises(UserError, match="holds no footage"):
        open_source(tmp_path / "none")
    one = open_source(footage_folder(tmp_path / "one", NAMES[:1], NAMES[:1]))
    assert (len(one.footage[0].numbers), one.fps, one.notes) == (1, 10.0, [])


def test_masks_beside_a_video_without_landmarks(tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "clip.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 10.0, (64, 64))
    writer.write(frame(0))
    writer.release()
    (tmp_path / "clip_masks").mkdir()
    with pytest.raises(UserError, match=r"clip_masks lies beside clip\.mp4, but no landmarks are named: give `landm"):
        open_source(tmp_path / "clip.mp4", SourceOptions(detector=Detector(tmp_path / "work", progress=False)))
