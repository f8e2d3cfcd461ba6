"""Level of detail: fewer, larger Gaussians of the same surface."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.play.framing import frame_motion, size_on_screen
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.values.motion import Motion


def test_fewer_larger_gaussians_close_the_surface(tiered_bundle):
    pose = np.zeros((52, 3), np.float32)
    avatar = Avatar(tiered_bundle, tier="baked")
    motion = Motion(pose[None], np.zeros((1, 3), np.float32), 30.0)
    camera = frame_motion(avatar, motion, 96, 96)
    rasterizer = build_rasterizer()
    whole = rasterizer.render(avatar.gaussians(pose), camera, (1, 1, 1)).alpha.copy()
    thin = Avatar(tiered_bundle, tier="baked", gaussians=len(avatar) // 2)
    part = rasterizer.render(thin.gaussians(pose), camera, (1, 1, 1)).alpha
    assert len(thin) == len(avatar) // 2
    inside = whole > 0.99
    assert (part[inside] > 0.9).mean() > 0.99


def test_detail_follows_the_persons_size_on_screen(fine_bundle):
    avatar = Avatar(fine_bundle, tier="baked")
    motion = Motion(np.zeros((2, 52, 3), np.float32), np.float32([[0, 0, 0], [0, 0, 1.0]]), 30.0)
    sizes = []
    for pixels in (48, 96):
        camera = frame_motion(avatar, motion, pixels, pixels)
        sizes.append(size_on_screen(avatar, motion, [camera, camera]))
        assert 0.5 * pixels < sizes[-1] < 1.3 * pixels
    assert sizes[1] == pytest.approx(2 * sizes[0])
    inside = dataclasses.replace(camera, T_camera_world=np.eye(4))
    assert size_on_screen(avatar, motion, [inside, inside]) == np.inf
