"""Images of 8192 pixels in a row: the far end is the same picture as a short image that begins there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from splat_scenes import simple_camera

from gavatar_runtime import native_library as nl
from gavatar_runtime.render.choice import player_rasterizers
from gavatar_runtime.values.gaussians import Gaussians

LONG, PART = 8192, 64


@pytest.mark.parametrize("name", ["native", "numpy"])
@pytest.mark.parametrize("upright", [False, True])
def test_the_last_pixels_of_8192_are_drawn_like_the_first_of_few(name, upright):
    if name == "native" and not nl.available()[0]:
        pytest.skip(nl.available()[1])
    camera = simple_camera(LONG, 4, focal=1000.0)
    rng = np.random.default_rng(0)
    depth = rng.uniform(1.5, 2.5, 40)
    pixel = rng.uniform(LONG - PART - 8, LONG + 8, 40)
    means = np.stack([(pixel - camera.cx) / 1000 * depth, np.zeros(40), depth], -1)
    part = dataclasses.replace(camera, width=PART, cx=camera.cx - (LONG - PART))
    if upright:
        means = means[:, [1, 0, 2]]
        camera = dataclasses.replace(camera, width=4, height=LONG, cx=camera.cy, cy=camera.cx)
        part = dataclasses.replace(camera, height=PART, cy=camera.cy - (LONG - PART))
    scene = Gaussians(*(np.float32(x) for x in (means, np.full(40, 0.003), rng.random((40, 3)))))
    rasterizer = player_rasterizers().build(name)
    whole = np.array(rasterizer.render(scene, camera).color)
    short = np.array(rasterizer.render(scene, part).color)
    assert whole.shape == ((LONG, 4, 3) if upright else (4, LONG, 3))
    end = whole[-PART:] if upright else whole[:, -PART:]
    assert (short != short[0, 0]).any()
    # a float32 coordinate near 8192 is good to 5e-4 pixels, and a Gaussian's flank of three pixels has a slope of 0.2
    np.testing.assert_allclose(end, short, atol=1e-3)
    assert (whole[:100, :4] == whole[0, 0]).all()  # nobody is there
