"""What builders of tiers start from: poses, body parts, and a fine surface that reads a coarse one."""

from __future__ import annotations

import numpy as np

from gavatar.export.tier_source import RANGE, AvatarSource, joint_of_points, limb_of_joints, upsampling


def test_wide_poses_bend_limbs_within_their_range_and_mirror_sides(tiered_run):
    source = AvatarSource(tiered_run, progress=False)
    poses = source.wide_poses(200)
    assert poses.shape == (200, 52, 3)
    assert np.isfinite(poses).all()
    assert poses[:, 4, 0].max() > 1.8  # deep knees
    assert poses[:, 16, 2].max() > 1.0  # the left arm high
    assert poses[:, 17, 2].min() < -1.0  # and the right one
    np.testing.assert_array_equal(poses, source.wide_poses(200))
    for joint, (low, high) in RANGE.items():
        assert np.all(np.less(low, high)), joint


def test_limbs_and_parts_follow_the_skeleton(tiered_run):
    parents = tiered_run.built.body.data.parents
    limb = limb_of_joints(parents)
    assert limb[[0, 3, 6, 9, 12, 15]].tolist() == [0] * 6
    assert limb[1] == limb[4] == limb[7] == limb[10] > 0
    assert limb[20] == limb[22]  # fingers with their arm
    assert len({limb[1], limb[2], limb[13], limb[14], 0}) == 5
    joint = joint_of_points(tiered_run.avatar.surface)
    assert joint.min() == 0
    assert joint.max() < 22  # fingers count to their hand


def test_upsampling_reproduces_a_smooth_function_on_the_body(tiered_run):
    coarse, fine = tiered_run.built.atlas(64), tiered_run.built.atlas(96)
    index, weight = upsampling(coarse, fine)
    np.testing.assert_allclose(weight.sum(1), 1, atol=1e-5)
    got = np.einsum("nkc,nk->nc", coarse.points[index], weight)
    error = np.linalg.norm(got - fine.points, axis=1)
    assert np.median(error) < 0.25 * np.median(coarse.spacing)
    assert error.max() < 3 * coarse.spacing.max()  # never another part of the body
