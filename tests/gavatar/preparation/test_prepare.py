"""gavatar-prepare writes a capture that reads back, and bad footage is refused in one sentence."""

import json

import cv2
import numpy as np
import pytest
from commands import run_prepare

from gavatar.capture.capture import read_capture
from gavatar.preparation.write import make_splits, new_folder
from gavatar_plugins.bodies.free import load_free_body

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.usefixtures("few_steps")
def test_the_command_writes_a_capture_that_reads_back(footage, tmp_path, capsys):
    out = tmp_path / "out" / "anna"
    assert run_prepare(footage, "-o", out, "--size", 64, "--license", "mine", "--quiet") == 0
    said = capsys.readouterr().out
    assert "camera unknown" in said
    assert "IoU" in said
    capture = read_capture(out)
    capture.check()
    assert (capture.license, capture.background, capture.body_model) == ("mine", "footage", "free")
    assert len(capture.motion) == 3
    color, alpha = capture.load(capture.views("train")[0])
    assert color.shape == (64, 48, 3)
    assert alpha.max() > 0.5
    assert (out / "preview.png").is_file()
    assert (out / "preview.mp4").is_file()
    assert [p.name for p in out.parent.iterdir()] == ["anna"]  # no temporary folder left
    # the person stands on the floor y = 0: half the frames' lowest points lie below it, half above
    vertices = [load_free_body().posed(p, capture.motion.betas, t)[0] for p, t in
                zip(capture.motion.poses, capture.motion.trans, strict=True)]  # fmt: skip
    assert np.median([v[:, 1].min() for v in vertices]) == pytest.approx(0, abs=1e-3)


@pytest.mark.usefixtures("few_steps")
def test_one_frame_of_footage_and_no_preview(footage, tmp_path):
    out = tmp_path / "one"
    assert run_prepare(footage, "-o", out, "--frames", "1:2", "--no-preview", "--quiet") == 0
    assert len(read_capture(out).motion) == 1
    assert not (out / "preview.png").exists()


@pytest.mark.usefixtures("few_steps")
def test_existing_output_is_kept_unless_told(footage, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "precious.txt").write_text("mine")
    assert run_prepare(footage, "-o", out, "--quiet") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run_prepare(footage, "-o", out, "--quiet", "--overwrite") == 2
    assert "no capture" in capsys.readouterr().err
    assert (out / "precious.txt").read_text() == "mine"


def _remove_mask(folder):
    (folder / "masks" / "000001.png").unlink()


def _resize_mask(folder):
    cv2.imwrite(str(folder / "masks" / "000002.png"), np.zeros((64, 64), np.uint8))


def _break_frame(folder):
    (folder / "frames" / "000002.png").write_bytes(b"not an image")


def _drop_landmarks(folder):
    (folder / "landmarks.npz").unlink()


def _shorten_landmarks(folder):
    with np.load(folder / "landmarks.npz") as file:
        arrays = dict(file)
    np.savez(folder / "landmarks.npz", **{**arrays, "image": arrays["image"][:2], "world": arrays["world"][:2]})


def _drop_frames(folder):
    for path in (folder / "frames").iterdir():
        path.unlink()


def _foreign_camera(folder):
    (folder / "cameras.json").write_text(json.dumps({"left": _camera_json()}))


def _wrong_camera_field(folder):
    (folder / "cameras.json").write_text(json.dumps({"cam0": {**_camera_json(), "world_to_camera": "none"}}))


def _camera_json():
    T = np.eye(4).tolist()
    return {"width": 96, "height": 128, "fx": 176, "fy": 176, "cx": 48, "cy": 64, "world_to_camera": T}


@pytest.mark.usefixtures("few_steps")
@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (_remove_mask, "000001.png is missing"),
        (_resize_mask, "64x64"),
        (_break_frame, "cannot be read as an image"),
        (_drop_landmarks, "landmarks.npz is missing"),
        (_shorten_landmarks, "has 2 frames"),
        (_drop_frames, "holds no footage"),
        (_foreign_camera, "no camera 'cam0'"),
        (_wrong_camera_field, "wrong type"),
    ],
)
def test_bad_footage_is_one_sentence_and_nothing_half_written(footage, tmp_path, capsys, harm, message):
    harm(footage)
    assert run_prepare(footage, "-o", tmp_path / "place" / "out", "--quiet") == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    place = tmp_path / "place"
    assert not place.exists() or not list(place.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--frames", "5"), "--frames"),
        (("--frames", "9:12"), "leaves nothing"),
        (("--size", "0"), "--size"),
        (("--fps", "-1"), "--fps"),
        (("--height", "17"), "--height"),
        (("--holdout-camera", "cam9"), "--holdout-camera"),
        (("--refine-cameras",), "--refine-cameras"),
        (("--body", "giant"), "giant"),
    ],
)
def test_bad_options_are_refused(footage, tmp_path, capsys, arguments, message):
    assert run_prepare(footage, "-o", tmp_path / "out", "--quiet", *arguments) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_splits_hold_out_every_tenth_frame_and_a_camera():
    assert make_splits(["a"], 1, None) == {"train": [["a", [0]]]}
    splits = make_splits(["a", "b"], 20, "b")
    assert splits["test"] == [["a", [5, 15]]]
    assert splits["novel_view"] == [["b", list(range(20))]]
    assert 5 not in splits["train"][0][1]
    assert len(splits["train"]) == 1


def test_a_failure_while_writing_restores_the_old_capture(tmp_path):
    old = tmp_path / "cap"
    old.mkdir()
    (old / "capture.json").write_text("{}")

    def write_half():
        with new_folder(old, overwrite=True) as folder:
            (folder / "x").write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert [p.name for p in tmp_path.iterdir()] == ["cap"]
    assert (old / "capture.json").read_text() == "{}"
