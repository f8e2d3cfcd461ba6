"""Captures: what is read, and one clear sentence for everything that can be wrong with one."""

from __future__ import annotations

import json
import sys

import cv2
import numpy as np
import pytest
from tiny_capture import SMALL, demo, write_tiny_capture

from gavatar.capture.capture import View, read_capture
from gavatar.capture.opening import open_capture
from gavatar.cli import train as train_command
from gavatar.registry import load_plugins
from gavatar_runtime.errors import UserError


@pytest.fixture
def tiny(tmp_path):
    return write_tiny_capture(tmp_path / "tiny")


def edit(path, change):
    info = json.loads(path.read_text())
    change(info)
    path.write_text(json.dumps(info))


def test_the_embedded_capture_opens_and_is_complete():
    capture = read_capture(demo())
    capture.check()
    assert capture.background == "white"
    assert {k: len(v) for k, v in capture.splits.items()} == {
        "train": 90, "test": 10, "novel_pose": 12, "novel_view": 8,
    }  # fmt: skip
    assert len(capture.motion) == len(capture.truth) == 112


def test_images_come_premultiplied_so_that_any_background_composites(tiny):
    capture = read_capture(tiny)
    color, alpha = capture.load(View("cam0", 0))
    assert color.shape == (256, 256, 3)
    assert color[alpha == 0].max() < 0.03  # what JPEG leaves of pure white outside the mask
    original = cv2.imread(str(capture.image_path(View("cam0", 0))))[..., ::-1] / 255
    # exact wherever clipping at zero did not act on JPEG noise
    assert np.abs(np.clip(color + 1 - alpha[..., None], 0, 1) - original).mean() < 1e-3


def test_footage_backgrounds_are_masked_away(tiny):
    edit(tiny / "capture.json", lambda c: c.update(background="footage"))
    color, alpha = read_capture(tiny).load(View("cam0", 0))
    assert color[alpha == 0].max() == 0


def test_a_capture_without_the_background_field_is_recognised_by_its_white(tiny):
    edit(tiny / "capture.json", lambda c: c.pop("background"))
    assert read_capture(tiny).background == "white"


def save_npz(path, **changes):
    with np.load(path) as file:
        arrays = dict(file) | changes
    np.savez(path, **arrays)


def nan_poses(tiny):
    with np.load(tiny / "body.npz") as file:
        poses = file["poses"].copy()
    poses[3, 7] = np.nan
    save_npz(tiny / "body.npz", poses=poses)


FAULTS = {
    "a missing frame": (lambda t: (t / "images/cam0/000002.jpg").unlink(), "000002", "missing"),
    "a missing mask": (lambda t: (t / "masks/cam0/000001.png").unlink(), "masks", "missing"),
    "a mask of another size": (
        lambda t: cv2.imwrite(str(t / "masks/cam0/000000.png"), np.zeros((10, 20), np.uint8)), "20x10", "256x256",
    ),
    "a damaged image": (lambda t: (t / "images/cam0/000000.jpg").write_bytes(b"no"), "000000.jpg", "image"),
    "NaN poses": (nan_poses, "body.npz", "frame 3"),
    "a later version": (lambda t: edit(t / "capture.json", lambda c: c.update(version=9)), "version 9", "upgrade"),
    "no version": (lambda t: edit(t / "capture.json", lambda c: c.pop("version")), "capture.json", "version"),
    "an unknown camera": (
        lambda t: edit(t / "capture.json", lambda c: c["splits"].update(test=[["cam7", [0]]])), "cam7", "cameras.json",
    ),
    "a frame beyond the motion": (
        lambda t: edit(t / "capture.json", lambda c: c["splits"].update(test=[["cam0", [99]]])), "99", "body.npz",
    ),
    "no training frames": (
        lambda t: edit(t / "capture.json", lambda c: c["splits"].update(train=[])), "capture.json", "train",
    ),
    "a malformed split": (
        lambda t: edit(t / "capture.json", lambda c: c["splits"].update(train=[1, 2])), "capture.json", "split 'train'",
    ),
    "broken JSON": (lambda t: (t / "cameras.json").write_text("{"), "cameras.json", "JSON"),
    "a camera without focal length": (
        lambda t: edit(t / "cameras.json", lambda c: c["cam0"].pop("fx")), "cameras.json", "fx",
    ),
    "a negative focal length": (
        lambda t: edit(t / "cameras.json", lambda c: c["cam0"].update(fx=-1)), "cameras.json", "positive",
    ),
    "an infinite camera": (
        lambda t: edit(t / "cameras.json", lambda c: c["cam0"].update(world_to_camera=[[float("nan")] * 4] * 4)),
        "cameras.json", "finite",
    ),
    "an unknown background": (
        lambda t: edit(t / "capture.json", lambda c: c.update(background="blue")), "background", "white",
    ),
    "truth of another length": (
        lambda t: save_npz(t / "body_truth.npz", poses=np.zeros((2, 156)), trans=np.zeros((2, 3))),
        "body_truth.npz", "2 frames",
    ),
}  # fmt: skip


def read_all(tiny):
    capture = read_capture(tiny)
    capture.check()
    capture.load(capture.views("train")[0])


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_one_sentence_naming_the_file(tiny, fault):
    breaks, *words = FAULTS[fault]
    breaks(tiny)
    with pytest.raises(UserError) as error:
        read_all(tiny)
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_folder_of_no_known_layout_says_what_is_known(tmp_path):
    load_plugins()
    with pytest.raises(UserError, match=r"capture\.json"):
        open_capture(tmp_path)
    with pytest.raises(UserError, match="not a directory"):
        open_capture(tmp_path / "nowhere")


def test_an_absent_split_names_those_there_are(tiny):
    with pytest.raises(UserError, match=r"no split 'val'.*train, test, novel_pose"):
        read_capture(tiny).views("val")


@pytest.mark.parametrize("fault", ["a missing frame", "a mask of another size", "NaN poses", "a later version"])
def test_training_on_a_faulty_capture_is_one_sentence_exit_code_two_and_nothing_written(
    tiny, tmp_path, fault, monkeypatch, capfd
):
    monkeypatch.setattr(sys, "argv", list(sys.argv))  # which gavatar-train sets for Hydra, as it does the variable
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    FAULTS[fault][0](tiny)
    with pytest.raises(SystemExit) as end:
        train_command.main([f"capture={tiny}", f"out={tmp_path / 'run'}", *SMALL])
    assert end.value.code == 2
    printed = capfd.readouterr().err
    assert len(printed.strip().splitlines()) == 1
    assert printed.startswith("error: ")
    assert not list((tmp_path / "run").rglob("*.pt"))
    assert fault == "a mask of another size" or not (tmp_path / "run").exists()
