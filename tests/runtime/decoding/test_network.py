"""Networks of a bundle whose rows are shared by threads."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.decoding.network import CHUNK, Network
from gavatar_runtime.tiers.members import DECODER, OUTPUTS, POSE_FEATURES


def test_threads_that_share_the_rows_decode_the_same(fine_bundle):
    pose = np.random.default_rng(0).normal(0, 0.3, (52, 3)).astype(np.float32)
    for tier in ("full", "int8"):
        one, three = (Avatar(fine_bundle, tier=tier, threads=n) for n in (1, 3))
        assert len(three) > 2 * CHUNK  # so that all three have a share
        for _ in range(2):  # the first call finds the shapes, the next fills what is there
            a, b = one.gaussians(pose), three.gaussians(pose)
            for x, y in ((a.means, b.means), (a.scales, b.scales), (a.colors, b.colors)):
                np.testing.assert_allclose(x, y, atol=1e-6)  # products of other shapes may be summed in another order


def test_rows_that_no_thread_can_decode_are_an_error_of_the_call(fine_bundle, tiered_run):
    decoder = Network(fine_bundle, DECODER, (POSE_FEATURES,), OUTPUTS, 2, by_rows=True)
    assert decoder.picks
    size = fine_bundle.surfaces()[1].resolution
    features = np.zeros((1, tiered_run.avatar.config.features, size, size), np.float32)
    rows = np.arange(2 * CHUNK, dtype=np.int32)
    rows[-1] = 10**6  # in the other thread's share
    with pytest.raises(Exception, match=r"(?i)gather|indices"):
        decoder(features, rows=rows)
    assert [len(x) for x in decoder(features, rows=rows[:1])] == [1, 1, 1]
