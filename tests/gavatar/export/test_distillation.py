"""What a pose does to an avatar as linear bases by body part."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gavatar.export.bundling import placed
from gavatar.export.distillation import bases_by_part, distil, fit_turns
from gavatar.export.tier_source import AvatarSource, joint_of_points
from gavatar_plugins.encoders.linear import harmonics
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.tiers.blendshape import Coefficients, pose_input, turn_input
from gavatar_runtime.tiers.members import BLENDSHAPE

OPTIONS = {"rank": 4, "uv": 64, "samples": 4, "wide": 4, "width": 8, "steps": 5}


def test_blendshapes_fade_into_the_still_look_far_from_filmed_poses(tiered_run, monkeypatch):
    monkeypatch.setattr("gavatar.export.distillation.JUDGED", 0)  # else kept only where it helps
    surface = tiered_run.avatar.surface
    arrays = distil(AvatarSource(tiered_run, progress=False), **OPTIONS)
    tier = Coefficients(arrays, surface.parents, "test")
    filmed = tiered_run.motion.motion().poses[0].astype(np.float32)
    joints = np.arange(1, 22)
    np.testing.assert_allclose(tier.shares(pose_input(filmed, joints)), 1, atol=1e-6)
    far = filmed.copy()
    far[1:22] += (0, 0, np.pi)  # a rotation by pi is 2 sqrt(2) from none
    np.testing.assert_array_equal(tier(far), 0)
    assert np.abs(tier(filmed)).max() > 0
    arm = filmed.copy()
    arm[[16, 18]] += (0, 0, np.pi)
    shares = tier.shares(pose_input(arm, joints))
    assert shares.min() < 1e-6  # the arm's own parts
    assert (shares > 1 - 1e-6).sum() > len(shares) // 2  # and no others
    values = [tier.shares(pose_input(filmed + t * (far - filmed), joints)).mean() for t in np.linspace(0, 0.5, 9)]
    assert (np.diff(values) <= 1e-6).all()
    endless = {k: v for k, v in arrays.items() if k not in ("seen", "near", "fade")}
    assert np.abs(Coefficients(endless, surface.parents, "test")(far)).max() > 0
    cut = {"seen": arrays["seen"][:, 9:], "near": arrays["near"][:, 1:]}  # of one joint less than it looks at
    for wrong in ({"seen": arrays["seen"][:, 1:]}, {"seen": arrays["seen"][:0]}, cut):
        sizes = {"N": len(arrays["part"]), "body_joints": surface.num_joints}
        with pytest.raises(UserError, match=r"test: array '(seen|near)'"):
            BLENDSHAPE.read(arrays | wrong, "test", sizes)


def test_body_parts_without_points_keep_the_others_bases_in_place(tiered_run, monkeypatch):
    monkeypatch.setattr("gavatar.export.distillation.JUDGED", 0)
    whole = tiered_run.avatar.surface
    joint = joint_of_points(whole)
    assert (joint == 0).any()
    kept = np.flatnonzero(joint != 0)  # the first part's numbers are not to be taken by the second
    all_of_it = distil(AvatarSource(tiered_run, progress=False), **OPTIONS)
    cut = distil(AvatarSource(placed(tiered_run, whole.take(kept)), progress=False), **OPTIONS)
    np.testing.assert_array_equal(cut["part"], all_of_it["part"][kept])
    np.testing.assert_array_equal(cut["near"], all_of_it["near"])
    assert cut["near"].any(1).all()  # every part hangs on some joint
    steps = [a["basis"] * a["gains"][a["part"]][:, None, :, None] for a in (cut, all_of_it)]
    np.testing.assert_allclose(steps[0], steps[1][kept], atol=all_of_it["gains"].max())  # half a step of int8 each


def test_a_part_that_no_pose_changes_has_bases_of_zero():
    residuals = np.random.default_rng(0).normal(size=(9, 7, 7)).astype(np.float32)
    part = np.array([0, 1, 0, 1, 1, 2, 0])
    residuals[:, part == 1] = 0  # as where no training view saw it
    coefficients, bases = bases_by_part(residuals, part, 4)
    assert (coefficients.shape, bases.shape) == ((9, 12), (7, 4, 7))
    assert not coefficients[:, 4:8].any()
    assert not bases[part == 1].any()
    assert bases[part != 1].any()


def test_light_on_a_turning_part_is_linear_in_what_distillation_looks_at(tiered_run):
    """Second-order harmonics of a normal carried by one joint, in poses that were not fitted to."""
    surface = tiered_run.avatar.surface
    owners = np.array([0, 4, 16])
    rng = np.random.default_rng(0)
    poses = rng.normal(0, 0.8, (500, 52, 3)).astype(np.float32)
    turned = turn_input(poses, owners, surface.parents)
    assert turned.shape == (500, 3, 55)
    T = joint_transforms(poses, surface.joints, surface.parents)[:, owners, :3, :3]
    np.testing.assert_allclose(turned[..., :9].reshape(500, 3, 3, 3), T, atol=1e-5)
    normals = rng.normal(size=(3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    world = torch.from_numpy(np.einsum("spab,pb->sap", turned[..., :9].reshape(500, 3, 3, 3), normals))
    light = harmonics(world, 2).transpose(1, 2).reshape(500, -1).numpy().astype(np.float32)
    joints = np.arange(22)
    near = np.zeros((3, 22), bool)
    inputs = pose_input(poses, joints)
    direct, turn = fit_turns(inputs[:400], turned[:400], light[:400], 0, near)
    assert not direct.any()
    got = np.einsum("spf,pfk->spk", turned[400:], turn).reshape(100, -1)
    assert np.abs(got - light[400:]).max() < 0.02 * np.abs(light).max()  # the ridge's pull towards zero
