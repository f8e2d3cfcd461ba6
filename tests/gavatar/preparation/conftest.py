"""What tests of preparing footage share."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from known_people import FPS, masks_of, plausible_motion, seen_by

from gavatar.preparation.fit import FitOptions
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.values.camera import Camera, look_at


@pytest.fixture
def few_steps(monkeypatch):
    """A fit of a few steps: enough to see that everything is written."""
    monkeypatch.setattr(FitOptions.__init__, "__defaults__", ((5, 5, 5), *FitOptions.__init__.__defaults__[1:]))


@pytest.fixture(scope="module")
def one_thread():
    """Small tensors: threads that wait for each other cost more than they bring."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def data():
    return load_free_body()


@pytest.fixture
def footage(tmp_path, data):
    """A folder like a phone's footage after detection: 3 frames of 96x128, masks, landmarks."""
    folder = tmp_path / "footage"
    for name in ("frames", "masks"):
        (folder / name).mkdir(parents=True)
    truth = plausible_motion(data, frames=3, turn=0.5)
    camera = Camera(96, 128, 176.0, 176.0, 48.0, 64.0, look_at((0, 0, 3.2), (0, -0.1, 0)))
    marks = seen_by(camera, truth, pixel_noise=0.3)
    for t, mask in enumerate(masks_of(data, camera, truth)):
        cv2.imwrite(str(folder / "frames" / f"{t:06d}.png"), np.full((128, 96, 3), 90, np.uint8))
        cv2.imwrite(str(folder / "masks" / f"{t:06d}.png"), mask)
    ones = np.ones((3, 33, 1))
    np.savez(
        folder / "landmarks.npz",
        image=np.concatenate([marks.image, 0 * ones, ones], -1),
        world=np.concatenate([marks.world, ones], -1),
        fps=FPS,
        width=96,
        height=128,
    )
    return folder
