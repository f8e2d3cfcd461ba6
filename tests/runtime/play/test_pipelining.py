"""Decoding ahead while a frame is drawn."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.play.player import play
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.values.motion import Motion


def test_a_pipelined_player_writes_the_same_images(tiered_bundle):
    class Keep:
        def __init__(self):
            self.images = []

        def choose(self, count):
            return list(range(count))

        def add(self, image):
            self.images.append(image.copy())

        def close(self):
            pass

        discard = close

    motion = Motion(
        np.random.default_rng(0).normal(0, 0.2, (6, 52, 3)).astype(np.float32), np.zeros((6, 3), np.float32), 30.0
    )
    results = []
    for pipelined in (False, True):
        avatar, writer = Avatar(tiered_bundle, tier="blendshape"), Keep()
        camera = frame_motion(avatar, motion, 64, 64)
        timings = play(avatar, motion, camera, build_rasterizer(), writer, pipelined=pipelined)
        assert len(timings) == 6
        results.append(writer.images)
    np.testing.assert_array_equal(*results)
