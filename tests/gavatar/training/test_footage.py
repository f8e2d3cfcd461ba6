"""Footage at the scale and in the windows that a level of training sees."""

from __future__ import annotations

import numpy as np
import pytest
from tiny_capture import write_tiny_capture

from gavatar.capture.opening import open_capture
from gavatar.registry import load_plugins
from gavatar.training.footage import FootageSource


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    load_plugins()
    return open_capture(write_tiny_capture(tmp_path_factory.mktemp("footage") / "tiny"))


@pytest.mark.parametrize("scale", [0.25, 1.0])
def test_windows_have_one_size_and_hold_the_whole_person(capture, scale):
    views = capture.views("train")
    cut, whole = (FootageSource(capture, views, crop=crop).at(scale) for crop in (True, False))
    height, width = cut.alpha.shape[1:]
    assert cut.color.shape == (len(views), 3, height, width)
    assert height % 16 == 0 or height == whole.alpha.shape[1]
    assert width % 16 == 0 or width == whole.alpha.shape[2]
    # nothing of a person is cut off, and each lies where its camera says
    assert np.array_equal(cut.alpha.sum((1, 2)), whole.alpha.sum((1, 2)))
    for row in range(len(views)):
        inside, outside = cut.cameras[row], whole.cameras[row]
        left, top = round(outside.cx - inside.cx), round(outside.cy - inside.cy)
        assert np.array_equal(cut.alpha[row], whole.alpha[row, top : top + height, left : left + width])


def test_footage_of_a_scale_is_made_once(capture):
    source = FootageSource(capture, capture.views("train"))
    assert source.at(0.5) is source.at(0.5)
    assert source.at(0.25).alpha.shape[1] < source.at(0.5).alpha.shape[1]
