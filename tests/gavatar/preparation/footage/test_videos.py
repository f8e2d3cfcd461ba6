"""Videos as phones, browsers and systems leave them: names, codecs, rotations, dynamic range, rates."""

import os
import shutil
import struct
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from demo_pictures import picture
from footage_folder import write_landmarks
from matroska import number, write_matroska

from gavatar.preparation.footage.container import codec_name, high_dynamic_range
from gavatar.preparation.footage.film import Film
from gavatar.preparation.footage.video_reading import video_facts, video_frames
from gavatar.preparation.footage_source import SourceOptions, open_source
from gavatar_runtime.errors import UserError

LEVELS = [np.full((48, 64, 3), 12 * t, np.uint8) for t in range(20)]
EVEN = [40 * t for t in range(20)]
NEEDS_FFMPEG = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no program ffmpeg on the PATH")


def opencv_video(path: Path, images, fourcc="mp4v") -> Path:
    plain = path.with_name("plain" + path.suffix)  # OpenCV's writer takes no odd names
    writer = cv2.VideoWriter(str(plain), cv2.VideoWriter_fourcc(*fourcc), 10.0, images[0].shape[1::-1])
    for image in images:
        writer.write(image)
    writer.release()
    return plain.rename(path)


def levels_of(images) -> list[int]:
    """Which of LEVELS each image is."""
    return [round(float(image.mean()) / 12) for image in images]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")
@pytest.mark.parametrize(
    "name", ["a:b.mp4", "Bildschirmvideo von 13.02.2022 13:19:57.mp4", "clip%03d.mp4", "what? [1] #2 é.mp4", "-i.mp4"]
)
def test_odd_signs_in_the_name_of_a_video(tmp_path, monkeypatch, name):
    """After blinry/nordlicht #55 and C4illin/ConvertX #442 (a colon is a protocol to FFmpeg); a percent sign is a row
    of pictures to OpenCV (opencv/opencv #14623)."""
    opencv_video(tmp_path / name, LEVELS)
    monkeypatch.chdir(tmp_path)
    assert video_facts(Path(name)).count == 20
    assert levels_of(video_frames(Path(name), np.array([0, 5, 5, 19]))) == [0, 5, 5, 19]


def test_an_empty_file_is_said_to_be_empty(tmp_path):
    (tmp_path / "a.mp4").touch()
    with pytest.raises(UserError, match=r"a\.mp4 cannot be read as a video: it is empty \(0 bytes\)"):
        video_facts(tmp_path / "a.mp4")


def test_a_video_without_frames_or_with_one(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match="cannot be read as a video"):
        video_facts(_no_frames(tmp_path))
    film = Film.of("cam0", opencv_video(tmp_path / "one.mp4", LEVELS[:1]))
    assert (len(film.order), film.rate, film.notes) == (1, 10.0, [])


def _no_frames(folder: Path) -> Path:
    whole = write_matroska(folder / "whole.mkv", LEVELS[:1], [0]).read_bytes()
    path = folder / "none.mkv"
    path.write_bytes(whole[: whole.index(b"\x1f\x43\xb6\x75")])  # the header and no cluster
    return path


# ---------------------------------------------------------------- codecs


def test_without_ffmpeg_the_codec_and_a_command_are_named(tmp_path, monkeypatch):
    """After opencv/opencv #24430: AV1, which OpenCV's wheels do not decode."""
    clip = opencv_video(tmp_path / "my clip.mp4", LEVELS)
    clip.write_bytes(clip.read_bytes().replace(b"mp4v", b"av01").replace(b"esds", b"free"))
    webm = write_matroska(tmp_path / "a.webm", LEVELS, EVEN, codec=b"V_AV1")
    monkeypatch.setenv("PATH", str(tmp_path))
    for path in (clip, webm):
        assert codec_name(path) == "AV1"
        with pytest.raises(UserError, match=r"OpenCV cannot decode its codec AV1; install the program ffmpeg.*or "
                                            r"convert the file: ffmpeg -i \S*file:.*-c:v libx264"):  # fmt: skip
            video_facts(path)


@NEEDS_FFMPEG
@pytest.mark.parametrize("numbers", [[0, 1, 2], [1, 4, 7], [0, 3, 3, 9]])
def test_with_ffmpeg_av1_is_decoded(tmp_path, numbers):
    """After opencv/opencv #24430; a colon in the name, too."""
    plain, path = opencv_video(tmp_path / "levels.mp4", LEVELS[:10]), tmp_path / "a:b.mp4"
    made = subprocess.run(["ffmpeg", "-v", "error", "-i", plain, "-c:v", "libaom-av1", "-cpu-used", "8",
                           f"file:{path}"], check=False, capture_output=True)  # fmt: skip
    if made.returncode:
        pytest.skip("the program ffmpeg cannot write AV1")
    facts = video_facts(path)
    assert (facts.count, facts.size) == (10, (64, 48))
    assert levels_of(video_frames(path, np.array(numbers))) == numbers
    if not cv2.VideoCapture(str(path)).read()[0]:
        assert facts.notes == (f"{path} is decoded by the program ffmpeg: OpenCV lacks its codec AV1",)


@NEEDS_FFMPEG
def test_what_ffmpeg_cannot_read_either_is_quoted(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"no video at all")
    with pytest.raises(UserError, match=r"cannot be read as a video, nor by the program ffmpeg: .*Invalid data"):
        video_facts(tmp_path / "a.mp4")


# ---------------------------------------------------------------- how it was filmed


MATRICES = {
    180: (-0x10000, 0, 0, 0, -0x10000, 0, 0, 0, 0x40000000),
    90: (0, 0x10000, 0, -0x10000, 0, 0, 0, 0, 0x40000000),
    270: (0, -0x10000, 0, 0x10000, 0, 0, 0, 0, 0x40000000),
}


@pytest.mark.parametrize("degrees", MATRICES)
def test_rotations_of_phones_are_followed(tmp_path, degrees):
    """After opencv/opencv #26876 (180 degrees) and #15499."""
    stored = np.ascontiguousarray(picture(0)[:, 40:216])
    path = opencv_video(tmp_path / "a.mp4", [stored] * 2)
    content = bytearray(path.read_bytes())
    k = content.index(b"tkhd")
    content[k + 44 : k + 80] = struct.pack(">9i", *MATRICES[degrees])
    path.write_bytes(content)
    turned = np.rot90(stored, -degrees // 90)
    assert video_facts(path).size == turned.shape[1::-1]
    (found,) = video_frames(path, np.array([1]))
    assert np.abs(found.astype(int) - turned).mean() < 6  # what the codec loses


@pytest.mark.parametrize(("transfer", "kind"), [(16, "PQ"), (18, "HLG"), (1, None)])
def test_high_dynamic_range_is_noted(tmp_path, transfer, kind):
    """After browser-use/video-use #6 and LibrePhotos/librephotos #455."""
    webm = write_matroska(tmp_path / "a.mkv", LEVELS, EVEN, colour=number(0x55BB, 9) + number(0x55BA, transfer))
    colr = struct.pack(">I8sHHHB", 19, b"colrnclx", 9, transfer, 9, 0)
    moov = struct.pack(">I4s", 8 + len(colr), b"moov") + colr
    (tmp_path / "a.mov").write_bytes(struct.pack(">I8sI", 16, b"ftypqt  ", 0) + moov)
    assert high_dynamic_range(webm) == high_dynamic_range(tmp_path / "a.mov") == kind
    notes = video_facts(webm).notes
    assert len(notes) == (kind is not None)
    assert kind is None or f"high dynamic range ({kind})" in notes[0]


def test_a_recording_of_a_browser_that_claims_a_thousand_frames(tmp_path):
    """After opencv/opencv-python #322: stamps in milliseconds, no rate, so that OpenCV says 1000."""
    times = np.cumsum(np.random.default_rng(0).integers(20, 50, 20)).tolist()
    path = write_matroska(tmp_path / "a.webm", LEVELS, times)
    film = Film.of("cam0", path)
    assert film.rate == pytest.approx(1000 * 19 / (times[-1] - times[0]), rel=0.1)
    if video_facts(path).rate == 1000:
        assert "time stamps" in film.notes[0]
    moments = times[0] + 1000 / film.rate * np.arange(len(film.order))
    assert np.abs(np.array(times)[film.order] - moments).max() < 50  # the nearest in time


def test_frames_that_slow_down_are_taken_by_their_time_stamps(tmp_path):
    """After Kinovea/Kinovea #154: an iPhone's frames are longer in the dark."""
    times = [100 * t for t in range(10)] + [1000 + 200 * t for t in range(10)]
    film = Film.of("cam0", write_matroska(tmp_path / "a.mkv", LEVELS, times))
    assert film.rate == pytest.approx(10, rel=0.01)
    assert levels_of(film.images(film.order)) == film.order.tolist()
    np.testing.assert_allclose(np.array(times)[film.order], 100 * np.arange(29), atol=100)
    assert "not evenly spaced" in film.notes[0]
    each = Film.of("cam0", tmp_path / "a.mkv", resample=False)
    assert (each.order.tolist(), each.notes) == (list(range(20)), [])


def test_landmarks_and_masks_follow_their_frames_in_time(tmp_path):
    folder = tmp_path / "f"
    (folder / "masks").mkdir(parents=True)
    times = [100 * t for t in range(10)] + [1000 + 200 * t for t in range(10)]
    write_matroska(folder / "video.mkv", LEVELS, times)
    for t in range(20):
        image = cv2.rectangle(np.zeros((48, 64), np.uint8), (9, 9), (20 + t, 40), 255, -1)
        cv2.imwrite(str(folder / f"masks/{t:06d}.png"), image)
    write_landmarks(folder / "landmarks.npz", 20)
    source = open_source(folder)
    (footage,) = source.footage
    assert (len(footage.numbers), source.fps) == (29, pytest.approx(10, rel=0.01))
    np.testing.assert_allclose(footage.landmarks.image[:, 0, 0] - 3, footage.numbers)
    assert [int((m[20] > 0).sum()) - 12 for m in footage.masks()] == footage.numbers.tolist()
    given = open_source(folder, SourceOptions(fps=12.0))
    assert (len(given.footage[0].numbers), given.fps) == (20, 12.0)
