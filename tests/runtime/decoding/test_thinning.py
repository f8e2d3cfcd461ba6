"""Level of detail: fewer, larger Gaussians of the same surface."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.decoding.detail import thinned, uv_for_size
from gavatar_runtime.errors import UserError
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
    uv = max(64, avatar.surface.resolution * 3 // 4)
    thin = Avatar(tiered_bundle, tier="baked", uv=uv)
    part = rasterizer.render(thin.gaussians(pose), camera, (1, 1, 1)).alpha
    assert len(thin) <= len(avatar)
    inside = whole > 0.99
    assert (part[inside] > 0.9).mean() > 0.99


def test_thinning_keeps_one_gaussian_a_cell_and_all_at_full_detail(tiered_bundle):
    surface, _ = tiered_bundle.surfaces()
    chosen, added = thinned(surface, surface.resolution)
    assert not added.any()
    assert len(chosen) == len(surface)
    finer = dataclasses.replace(surface, resolution=2 * surface.resolution, texel=_doubled(surface))
    chosen, added = thinned(finer, surface.resolution)
    # every fine texel has no neighbour here, so no spacing is known and none is made up
    assert not added.any()
    assert len(chosen) == len(surface)
    with pytest.raises(UserError, match="detail from 64"):
        thinned(surface, surface.resolution + 1)
    with pytest.raises(UserError, match="detail from 64"):
        thinned(surface, 63)
    assert uv_for_size(surface, 1) == 64
    assert uv_for_size(surface, 1e6) == surface.resolution


def _doubled(surface):
    row, column = np.divmod(surface.texel, surface.resolution)
    return 4 * row * surface.resolution + 2 * column


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
    assert uv_for_size(avatar.surface, np.inf) == avatar.surface.resolution
