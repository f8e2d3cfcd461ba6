"""Raw video becomes a capture; what is wrong with a video is said in one sentence."""

import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from commands import run_prepare
from demo_pictures import picture, true_mask
from places import DEMO

from gavatar.capture.capture import read_capture
from gavatar.preparation.detect import Detector
from gavatar.preparation.draw import iou
from gavatar.preparation.footage.video_reading import video_facts, video_frames
from gavatar.preparation.footage_source import SourceOptions, open_source
from gavatar.preparation.pose_network import PoseNetworks
from gavatar_runtime.errors import UserError


@pytest.fixture(scope="module")
def networks():
    return PoseNetworks()


# ---------------------------------------------------------------- video files


def write_video(path: Path, images, fps=10.0) -> Path:
    size = images[0].shape[1::-1]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), fps, size)
    for image in images:
        writer.write(image)
    writer.release()
    return path


def turn_by_metadata(path: Path) -> None:
    """Write 'turn by 90 degrees clockwise' into an mp4's track header, as phones do."""
    content = bytearray(path.read_bytes())
    k = content.index(b"tkhd")
    matrix = struct.pack(">9i", 0, 0x10000, 0, -0x10000, 0, 0, 0, 0, 0x40000000)
    content[k + 4 + 40 : k + 4 + 76] = matrix  # version 0: 40 bytes of times, number, duration, layer, volume
    path.write_bytes(content)


def test_a_phones_note_to_turn_the_picture_is_followed(tmp_path, networks):
    upright = [np.ascontiguousarray(picture(t)[:, 40:216]) for t in range(2)]
    path = write_video(tmp_path / "a.mp4", [cv2.rotate(i, cv2.ROTATE_90_COUNTERCLOCKWISE) for i in upright])
    assert video_facts(path).size == (256, 176)
    turn_by_metadata(path)
    facts = video_facts(path)
    assert (facts.count, facts.rate, facts.size) == (2, 10.0, (176, 256))
    (frame,) = video_frames(path, np.array([1]))
    assert np.abs(frame.astype(int) - upright[1]).mean() < 6  # what the codec loses
    assert abs(networks.detect(frame)[0].region.angle) < 0.2


def test_chosen_frames_are_decoded_exactly(tmp_path):
    levels = [np.full((32, 48, 3), 20 * t, np.uint8) for t in range(10)]
    path = write_video(tmp_path / "a.avi", levels)
    assert video_facts(path).count == 10
    found = [int(image.mean().round()) for image in video_frames(path, np.array([0, 3, 9]))]
    np.testing.assert_allclose(found, [0, 60, 180], atol=3)
    with pytest.raises(UserError, match="ends at frame 10"):
        list(video_frames(path, np.array([12])))


# ---------------------------------------------------------------- the command


@pytest.mark.usefixtures("few_steps")
def test_a_plain_video_becomes_a_capture(tmp_path, capsys):
    clip = write_video(tmp_path / "clip.mp4", [picture(t) for t in range(7)])
    out = tmp_path / "capture"
    assert run_prepare(clip, "-o", out, "--max-frames", 4, "--quiet") == 0
    said = capsys.readouterr().out
    assert "every second of 7 frames" in said
    assert "4 frames" in said
    capture = read_capture(out)
    capture.check()
    assert len(capture.motion) == 4
    assert capture.motion.fps == pytest.approx(5.0)
    for k, t in enumerate((0, 2, 4, 6)):
        mask = cv2.imread(str(out / f"masks/cam0/{k:06d}.png"), cv2.IMREAD_GRAYSCALE) > 127
        assert iou(mask, true_mask(t)) > 0.95
    assert (out / "preview.mp4").is_file()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["capture", "clip.mp4"]


def test_videos_that_cannot_be_used_are_one_sentence(tmp_path, capsys):
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"not a video")
    empty = write_video(tmp_path / "empty.mp4", [np.full((96, 64, 3), 90, np.uint8)] * 3)
    for source, message in ((broken, "cannot be read as a video"), (empty, "no person found in 'cam0'"),
                            (tmp_path / "none.mp4", "does not exist")):  # fmt: skip
        assert run_prepare(source, "-o", tmp_path / "out" / "a", "--quiet") == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
        assert not (tmp_path / "out").exists()
    wrong = tmp_path / "net.onnx"
    wrong.write_bytes(b"no network")
    assert run_prepare(empty, "-o", tmp_path / "out", "--pose-network", wrong, "--quiet") == 2
    assert "net.onnx cannot be read as an ONNX network" in capsys.readouterr().err


def test_landmarks_without_masks_are_not_replaced_silently(tmp_path):
    shutil.copytree(
        DEMO / "images" / "cam0", tmp_path / "frames", ignore=lambda d, names: [n for n in names if n > "000002.jpg"]
    )
    (tmp_path / "masks").mkdir()
    with pytest.raises(UserError, match=r"landmarks.npz is missing: give `landmarks`"):
        open_source(tmp_path, SourceOptions(detector=Detector(tmp_path / "work", progress=False)))
    (tmp_path / "masks").rmdir()
    with pytest.raises(UserError, match="give `fps`"):
        open_source(tmp_path, SourceOptions(detector=Detector(tmp_path / "work", progress=False)))
    source = open_source(tmp_path, SourceOptions(detector=Detector(tmp_path / "work", progress=False), fps=12.0))
    assert (len(source.footage[0].landmarks), source.fps) == (3, 12.0)
