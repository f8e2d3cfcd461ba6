"""Footage that is believed only in part: masks cut too wide."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.capture.opening import open_capture
from gavatar.config import check, compose_config
from gavatar.images.image_quality import ssim
from gavatar.training.footage import Comparison, Footage, FootageSource, edge_known
from gavatar_runtime.errors import UserError


def disc(side: int, radius: float) -> np.ndarray:
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    return np.where(np.hypot(x, y) < radius, 255, 0).astype(np.uint8)


def test_only_the_inner_border_of_a_mask_is_not_believed():
    mask = disc(64, 20)
    unknown = edge_known(mask, 4) == 0
    assert not unknown[mask == 0].any()
    inner = disc(64, 15) > 0  # further than 4 pixels from anything outside
    assert not unknown[inner].any()
    assert unknown[(disc(64, 16.5) == 0) & (mask > 0)].all()


@pytest.mark.parametrize("fill", [0, 255])
def test_a_mask_without_a_border_is_believed_everywhere(fill):
    assert (edge_known(np.full((5, 7), fill, np.uint8), 3) == 255).all()


def test_a_person_cut_off_by_the_image_has_no_border_there():
    mask = np.zeros((20, 20), np.uint8)
    mask[5:, 5:15] = 255  # the feet are below the image
    known = edge_known(mask, 2) == 255
    assert known[-1, 8:12].all()
    assert not known[6, 5:15].any()


def test_a_mask_of_one_pixel_is_all_border():
    mask = np.zeros((5, 5), np.uint8)
    mask[2, 2] = 255
    assert (edge_known(mask, 1) == 0).sum() == 1


def test_no_loss_moves_a_pixel_that_is_not_believed():
    known = np.full((1, 32, 32), 255, np.uint8)
    known[0, 10:20, 10:14] = 0
    data = Footage([], [], torch.zeros(1, 3, 32, 32), torch.zeros(1, 32, 32), torch.from_numpy(known))
    torch.manual_seed(0)
    render, target = torch.rand(1, 3, 32, 32, requires_grad=True), torch.rand(1, 3, 32, 32)
    alpha, mask = torch.rand(1, 32, 32, requires_grad=True), torch.rand(1, 32, 32)
    seen = Comparison(target, render, mask, alpha)
    part = data.believed([0], seen)
    loss = (part.target - part.render).abs().mean() + (1 - ssim(part.render, part.target).mean())
    (loss + (part.mask - part.alpha).square().mean()).backward()
    for gradient in (render.grad[0].abs().amax(0), alpha.grad[0].abs()):
        assert (gradient[torch.from_numpy(known[0]) == 0] == 0).all()
        assert (gradient[torch.from_numpy(known[0]) == 255] > 0).float().mean() > 0.9
    # where all is known nothing is touched
    whole = Footage([], [], data.color, data.alpha)
    assert whole.believed([0], seen) is seen


def test_the_believed_part_follows_image_scale_and_crop(tmp_path):
    capture = open_capture(write_tiny_capture(tmp_path / "tiny"))
    data = FootageSource(capture, capture.views("train"), mask_edge=8).at(0.25)
    assert data.known.shape == data.alpha.shape
    band = data.known < 128
    assert band.any()
    assert (data.alpha[band] > 0).all()
    assert float(band.float().sum() / (data.alpha > 127).float().sum()) < 0.9  # there is a person left


@pytest.mark.parametrize("value", ["-1", "nan", "inf"])
def test_an_impossible_edge_is_refused(value):
    with pytest.raises(UserError, match="mask_edge"):
        check(compose_config(["capture=x", "out=x", *SMALL, f"mask_edge={value}"]))
