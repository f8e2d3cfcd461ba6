"""Exposures that drift from image to image are learnt and kept out of the avatar."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from stopped_runs import stopped_after
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import compose_config
from gavatar.storage import load_tensors, write_image
from gavatar.training.remedies.exposure import Exposure
from gavatar.training.run import open_run, train

STATIC = [*(o for o in SMALL if not o.startswith("encoder")), "encoder=none", "motion.guard=false"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


def config(capture, out, *overrides):
    return compose_config([f"capture={capture}", f"out={out}", *STATIC, *overrides])


def test_gains_have_mean_one_and_leave_the_background_alone():
    exposure = Exposure(4)
    render, alpha = torch.rand(2, 3, 5, 5), torch.zeros(2, 5, 5)
    background = torch.tensor([0.2, 0.4, 0.6])
    alpha[:, :2] = 1.0
    render[:, :, 2:] = background[:, None, None]
    torch.testing.assert_close(exposure([0, 2], render, alpha, background), render)  # starts at one
    with torch.no_grad():
        exposure.log_gain.normal_()
    torch.testing.assert_close(exposure.gains([0, 1, 2, 3]).log().mean(0), torch.zeros(3), atol=1e-6, rtol=0)
    changed = exposure([0, 2], render, alpha, background)
    torch.testing.assert_close(changed[:, :, 2:], render[:, :, 2:])
    torch.testing.assert_close(changed[:, :, :2], exposure.gains([0, 2])[:, :, None, None] * render[:, :, :2])


def test_planted_exposures_are_found(capture, tmp_path):
    gains = np.exp([0.3, -0.2, 0.1, -0.3, 0.15, -0.05])
    flickering = write_tiny_capture(tmp_path / "flicker")
    for frame, gain in enumerate(gains):
        path = flickering / "images" / "cam0" / f"{frame:06d}.jpg"
        image, mask = cv2.imread(str(path)), cv2.imread(str(flickering / "masks" / "cam0" / f"{frame:06d}.png"))
        person = np.minimum(image * gain, 255)
        write_image(path, (np.where(mask > 127, person, image) / 255)[..., ::-1])
    steps = [
        "stage1.steps=60",
        "stage1.batch=3",
        "stage1.levels=[{until:1.0,gaussians:2850,image:0.125}]",
        "motion.enabled=false",
    ]
    made = train(config(flickering, tmp_path / "run", "exposure=true", *steps), tmp_path / "run")
    found = made.scene.exposure.gains(list(range(6))).detach().numpy().mean(1)
    expected = gains / np.exp(np.log(gains).mean())
    # frames are of different sides of a person, lit differently, and bright pixels are clipped: the order and most of
    # the range must come out
    assert np.corrcoef(np.log(found), np.log(expected))[0, 1] > 0.9
    assert open_run(tmp_path / "run").avatar  # evaluation knows no gains


def test_exposures_are_resumed_too(capture, tmp_path):
    whole = train(config(capture, tmp_path / "whole", "exposure=true"), tmp_path / "whole")
    assert whole.scene.exposure.log_gain.abs().max() > 0
    with stopped_after():
        train(config(capture, tmp_path / "parts", "exposure=true"), tmp_path / "parts")
    resumed = train(config(capture, tmp_path / "parts", "exposure=true"), tmp_path / "parts")
    assert torch.equal(whole.scene.exposure.log_gain, resumed.scene.exposure.log_gain)
    states = [load_tensors(tmp_path / name / "stage1.pt")["avatar"] for name in ("whole", "parts")]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])
