"""What is left to `auto` is decided by what the footage shows, noted with its number, and told in one paragraph."""

from __future__ import annotations

import json
import logging

import cv2
import numpy as np
import pytest
import torch
from stopped_runs import stopped_after
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import LevelConfig, check, compose_config
from gavatar.storage import load_tensors, write_image
from gavatar.training.remedies.brightness import brightness
from gavatar.training.remedies.pose_quality import unsteadiness
from gavatar.training.run import open_run, train
from gavatar.training.trainer import Trainer
from gavatar_runtime.errors import UserError

ASKED = ("mask_matte", "exposure")
FRAMES = tuple(range(0, 60, 6))  # a person turns once
STATIC = [*(o for o in SMALL if not o.startswith("encoder")), "encoder=none", "checkpoint_every=10"]
STATIC += ["stage1.steps=40", "stage1.batch=4", "stage1.lr_decoder=0.01", "preview_every=1000"]
STATIC += ["stage1.levels=[{until:1.0,gaussians:2850,image:0.25}]"]


def written(folder, change=lambda frame, image, mask: (image, mask), frames=FRAMES):
    """A tiny capture with every training picture changed, image BGR on white and mask (H, W), both uint8."""
    write_tiny_capture(folder, frames=frames)
    for frame in range(len(frames)):
        paths = folder / "images/cam0" / f"{frame:06d}.jpg", folder / "masks/cam0" / f"{frame:06d}.png"
        image, mask = change(frame, cv2.imread(str(paths[0])), cv2.imread(str(paths[1]), cv2.IMREAD_GRAYSCALE))
        write_image(paths[0].with_suffix(".png"), image[..., ::-1] / 255)
        paths[0].unlink()
        write_image(paths[1], np.repeat(mask[..., None], 3, -1) / 255)
    return folder


def drifting(frame, image, mask):
    """Brightness that rises and falls by a fifth, on white."""
    share, gain = mask[..., None] / 255, np.exp(0.2 * np.sin(2 * np.pi * frame / len(FRAMES)))
    return np.minimum((image - 255 * (1 - share)).clip(0) * gain, 255 * share) + 255 * (1 - share), mask


def widened(frame, image, mask):
    return image, cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7)))


@pytest.fixture(scope="module")
def steady(tmp_path_factory):
    return written(tmp_path_factory.mktemp("steady") / "tiny")


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    """Masks 3 pixels too wide, and brightness that drifts."""
    change = lambda frame, image, mask: widened(frame, *drifting(frame, image, mask))  # noqa: E731
    return written(tmp_path_factory.mktemp("faulty") / "tiny", change)


def trained(capture, out, *overrides):
    return train(compose_config([f"capture={capture}", f"out={out}", *STATIC, *overrides]), out)


def test_faults_are_found_mended_noted_and_told(faulty, tmp_path, caplog):
    with caplog.at_level(logging.WARNING, logger="gavatar.training"):
        made = trained(faulty, tmp_path)
    choices = json.loads((tmp_path / "metrics.json").read_text())["verdicts"]["choices"]
    assert set(choices) >= {"mask_matte", "exposure", "motion.start", "motion.mend"}
    assert choices["mask_matte"]["value"] == 5
    assert choices["mask_matte"]["measured"] == pytest.approx(3, abs=0.5)
    assert choices["exposure"]["value"] is True
    assert choices["exposure"]["measured"] > 0.1  # of 0.14, a sine of 0.2
    assert made.scene.exposure is not None
    assert made.scene.footage.mask_matte == open_run(tmp_path).config.mask_matte == 5
    (told,) = [r.getMessage() for r in caplog.records if "measured on the footage" in r.getMessage()]
    assert "masks are too wide by 3" in told
    assert "corrected" in told


def test_footage_without_faults_is_left_alone(steady, tmp_path):
    """Bit by bit as if nothing had been looked at."""
    auto = trained(steady, tmp_path / "auto", "motion.enabled=false")
    by_hand = trained(steady, tmp_path / "hand", "motion.enabled=false", "mask_matte=0", "exposure=false")
    assert [auto.record.verdicts.choices[name].value for name in ASKED] == [0, False]
    assert not set(ASKED) & set(by_hand.record.verdicts.choices or {})
    states = [load_tensors(tmp_path / name / "stage1.pt")["avatar"] for name in ("auto", "hand")]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])


def test_what_is_given_by_hand_is_not_asked(faulty, tmp_path):
    given = ("mask_matte=-2", "exposure=false", "motion.start=0.5", "motion.mend=0", "motion.betas=false")
    made = trained(faulty, tmp_path, "stage1.steps=2", *given)
    assert not {*ASKED, "motion.start", "motion.mend", "motion.betas"} & set(made.record.verdicts.choices or {})
    assert made.scene.exposure is None
    assert made.scene.footage.mask_matte == -2


@pytest.mark.parametrize("step", [10, 30])
def test_a_run_stopped_before_or_after_the_decisions_resumes_to_the_same(faulty, tmp_path, step):
    settings = ("motion.guard=false",)
    whole = trained(faulty, tmp_path / "whole", *settings)
    with stopped_after(("stage1", step)):
        trained(faulty, tmp_path / "parts", *settings, "motion.mend=auto")
    resumed = trained(faulty, tmp_path / "parts", *settings)
    assert resumed.record.verdicts == whole.record.verdicts
    assert torch.equal(whole.scene.exposure.log_gain, resumed.scene.exposure.log_gain)
    for part in ("avatar", "motion"):
        states = [load_tensors(tmp_path / name / "stage1.pt")[part] for name in ("whole", "parts")]
        assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])


def scene_of(capture, out):
    scene = Trainer(check(compose_config([f"capture={capture}", f"out={out}", *STATIC])), out).scene
    scene.place(LevelConfig(uv=64))
    return scene


def empty(frame, image, mask):
    return np.full_like(image, 255), np.zeros_like(mask)


def white(frame, image, mask):
    return np.full_like(image, 255), np.full_like(mask, 255)


@pytest.mark.parametrize("change", [empty, white])
@pytest.mark.parametrize("count", [1, 10])
def test_footage_that_tells_nothing_changes_nothing(tmp_path, change, count):
    capture = written(tmp_path / "tiny", change, FRAMES[:count])
    scene = scene_of(capture, tmp_path / "run")
    for value in (brightness(scene, 0.25), unsteadiness(scene, 0.25)):
        assert value is None or np.isfinite(getattr(value, "common", value))
    choices = trained(capture, tmp_path / "run", "stage1.steps=3").record.verdicts.choices
    assert [choices[name].value for name in ("mask_matte", "exposure", "motion.mend")] == [0, False, False]


def test_poses_that_are_wrong_fit_the_masks_unevenly(steady, tmp_path):
    scene = scene_of(steady, tmp_path)
    estimated = unsteadiness(scene, 0.25)
    with torch.no_grad():
        scene.motion.trans_correction[::2, 0] += 0.2
    assert unsteadiness(scene, 0.25) > 1.2 * estimated


@pytest.mark.parametrize("value", ["maybe", "1", "null"])
@pytest.mark.parametrize("name", ["exposure", "motion.betas"])
def test_a_choice_is_true_false_or_auto(name, value):
    with pytest.raises(UserError, match=f"{name} must be true, false or auto, not"):
        check(compose_config(["capture=x", "out=x", f"{name}={value}"]))


@pytest.mark.parametrize(("name", "value", "said"), [
    ("mask_matte", "wide", "mask_matte must be auto or a number of pixels, not 'wide'"),
    ("mask_matte", "nan", "mask_matte must be auto or a number of pixels"),
    ("mask_matte", "true", "mask_matte must be auto or a number of pixels"),
    ("motion.start", "late", "motion.start and motion.end must be fractions"),
    ("motion.start", "nan", "motion.start and motion.end must be fractions"),
    ("motion.sharing", "far", "motion.sharing must be a number of at least 0, or auto, not 'far'"),
    ("motion.mend", "late", "motion.mend must be a fraction of the stage, or auto, not 'late'"),
])  # fmt: skip
def test_what_is_neither_a_number_nor_auto_is_named(name, value, said):
    with pytest.raises(UserError, match=said):
        check(compose_config(["capture=x", "out=x", f"{name}={value}"]))


@pytest.mark.parametrize("preset", ["default", "demo"])
def test_presets_of_ours_leave_the_choice_to_the_footage(preset):
    config = check(compose_config(["capture=x", "out=x", f"experiment={preset}"]))
    motion = config.motion
    chosen = [config.mask_matte, config.exposure, motion.start, motion.sharing, motion.mend, motion.betas]
    assert chosen == ["auto"] * 6


@pytest.mark.parametrize("preset", ["paper", "upstream"])
def test_presets_of_others_choose_nothing(preset):
    config = check(compose_config(["capture=x", "out=x", f"experiment={preset}"]))
    motion = config.motion
    chosen = [config.mask_matte, config.exposure, motion.start, motion.sharing, motion.mend, motion.betas]
    assert chosen == [0, False, 0, 0, 0, False]
