"""Decoding ahead while a frame is drawn."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.play.outputs.nowhere import Nowhere
from gavatar_runtime.play.player import play_images
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.values.motion import Motion


class Images(Nowhere):
    """Keeps them."""

    def __init__(self):
        super().__init__()
        self.images = []

    def add(self, image):
        self.images.append(image.copy())


def test_a_pipelined_player_writes_the_same_images(tiered_bundle):
    motion = Motion(
        np.random.default_rng(0).normal(0, 0.2, (6, 52, 3)).astype(np.float32), np.zeros((6, 3), np.float32), 30.0
    )
    results = []
    for pipelined in (False, True):
        renderer, kept = Renderer(Avatar(tiered_bundle, tier="blendshape")), Images()
        camera = frame_motion(renderer.avatar, motion, 64, 64)
        timings = play_images(renderer, motion, camera, kept, pipelined=pipelined)
        assert len(timings) == len(kept.images) == 6
        results.append(kept.images)
    np.testing.assert_array_equal(*results)
    assert (results[0][0] != results[0][1]).any()
