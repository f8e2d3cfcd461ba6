"""One avatar on the points of several samplings of its body."""

from __future__ import annotations

import numpy as np
import torch

from gavatar.training.posing import pose_features


def test_an_avatar_sampled_elsewhere_is_what_it_would_be_there_and_stays_where_it_is(tiered_run):
    avatar, built, here = tiered_run.avatar, tiered_run.built, tiered_run.avatar.surface
    features = pose_features(avatar, built, tiered_run.motion.motion().poses[:2])
    with torch.no_grad():
        before = avatar.attributes(features)
        there = avatar.sampled(built.atlas(96))
        twin = there.attributes(features)
        after = avatar.attributes(features)
    assert avatar.surface is here
    assert there.surface is built.atlas(96)
    assert twin.offsets.shape == (2, len(built.atlas(96)), 3)
    for a, b in ((before.offsets, after.offsets), (before.colors, after.colors), (before.scales, after.scales)):
        assert torch.equal(a, b)
    with torch.no_grad():  # and back: the same numbers, to the last bit
        again = there.sampled(here).attributes(features)
    assert torch.equal(again.colors, before.colors)


def test_twins_share_their_parameters_and_nothing_that_is_of_their_points(tiered_run):
    avatar = tiered_run.avatar
    twin = avatar.sampled(tiered_run.built.atlas(96))
    own = dict(avatar.named_parameters())
    assert all(parameter is own[name] for name, parameter in twin.named_parameters())
    assert len(twin.points) != len(avatar.points)
    twin.encoder, twin.with_normals = None, True
    assert avatar.encoder is not None
    assert not avatar.with_normals


def test_a_twin_on_some_of_the_points_decodes_those(tiered_run):
    avatar = tiered_run.avatar
    rows = np.arange(0, len(avatar.surface), 3)
    features = pose_features(avatar, tiered_run.built, tiered_run.motion.motion().poses[:1])
    with torch.no_grad():
        whole, part = avatar.attributes(features), avatar.sampled(avatar.surface.take(rows)).attributes(features)
    # products of fewer rows may be summed in another order
    torch.testing.assert_close(part.colors[0], whole.colors[0][rows], atol=1e-6, rtol=0)
    torch.testing.assert_close(part.scales[0], whole.scales[0][rows], atol=1e-7, rtol=0)
