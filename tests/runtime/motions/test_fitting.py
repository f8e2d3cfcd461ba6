"""A motion brought to the joints, hands and expressions of a body."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gavatar_runtime.motions.fitting import fit_motion
from gavatar_runtime.values.body import SMPL_BODY_JOINTS, Hands
from gavatar_runtime.values.motion import HandParameters, Motion
from gavatar_runtime.values.skeletons import BODY, SMPL, SMPLH, SMPLX


def named_motion(names, frames=2):
    """A motion whose joint j turns by j + 1 hundredths about x."""
    poses = np.zeros((frames, len(names), 3), np.float32)
    poses[:, :, 0] = 0.01 * (1 + np.arange(len(names)))
    return Motion(poses, np.zeros((frames, 3), np.float32), 30.0)


@pytest.mark.parametrize("source", [BODY, SMPL, SMPLH, SMPLX], ids=["body", "smpl", "smplh", "smplx"])
@pytest.mark.parametrize("target", [BODY, SMPL, SMPLH, SMPLX], ids=["body", "smpl", "smplh", "smplx"])
def test_between_skeletons_every_rotation_goes_to_the_joint_of_its_name(source, target):
    motion = named_motion(source)
    fitted, ignored = fit_motion(motion, target)
    assert set(ignored) == set(source) - set(target)
    for j, name in enumerate(target):
        expected = motion.poses[:, source.index(name)] if name in source else np.zeros((2, 3))
        np.testing.assert_array_equal(fitted.poses[:, j], expected, err_msg=name)


def test_joints_that_do_not_move_are_not_reported_as_ignored():
    motion = named_motion(SMPLH)
    motion.poses[:, SMPL_BODY_JOINTS:] = 0
    assert fit_motion(motion, SMPL)[1] == ()


def test_a_skeleton_of_unknown_size_keeps_the_order_of_its_joints():
    motion = named_motion([f"j{i}" for i in range(30)])
    fitted, ignored = fit_motion(motion, SMPL)
    np.testing.assert_array_equal(fitted.poses, motion.poses[:, :24])
    assert ignored == tuple(f"joint {j}" for j in range(24, 30))
    fitted, ignored = fit_motion(dataclasses.replace(motion, poses=motion.poses[:, :5]), SMPL)
    assert fitted.poses.shape == (2, 24, 3)
    assert ignored == ()
    assert not fitted.poses[:, 5:].any()


def hands_of(count=12):
    rng = np.random.default_rng(3)
    return Hands(rng.normal(0, 0.3, (2, 15, 3)), rng.normal(0, 0.3, (2, count, 45)))


@pytest.mark.parametrize("pca", [True, False])
@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("names", [SMPLH, SMPLX], ids=["smplh", "smplx"])
def test_hand_parameters_become_finger_rotations_by_the_bodys_hand_data(names, pca, relative):
    hands, motion = hands_of(), named_motion(BODY)
    values = np.random.default_rng(0).normal(0, 0.5, (2, 2, 6 if pca else 45)).astype(np.float32)
    motion = dataclasses.replace(motion, hands=HandParameters(values, pca, relative))
    fitted, ignored = fit_motion(motion, names, np.full((len(names), 3), 0.7), hands=hands)
    assert ignored == ()
    assert fitted.hands is None
    for side, finger in ((0, "left_index1"), (1, "right_index1")):
        rotations = values[:, side] @ hands.components[side][:6] if pca else values[:, side]
        expected = rotations + (hands.mean[side].reshape(45) if relative else 0)
        at = names.index(finger)
        np.testing.assert_allclose(fitted.poses[:, at : at + 15].reshape(2, 45), expected, atol=1e-6)  # float32
    if names is SMPLX:
        np.testing.assert_allclose(fitted.poses[:, names.index("jaw")], 0.7, atol=1e-6)


@pytest.mark.parametrize("hands", [None, hands_of(0), hands_of(5)], ids=["none", "empty", "too few"])
def test_hand_parameters_that_the_body_has_no_data_for_are_named_and_left_at_rest(hands):
    motion = named_motion(BODY)
    motion = dataclasses.replace(motion, hands=HandParameters(np.ones((2, 2, 6), np.float32)))
    fitted, ignored = fit_motion(motion, SMPLH, np.full((52, 3), 0.2), hands=hands)
    assert ignored == ("hand components",)
    np.testing.assert_allclose(fitted.poses[:, 22:], 0.2)
    assert fit_motion(motion, SMPL, hands=hands_of())[1] == ("hand components",)  # data, but no fingers
    still = dataclasses.replace(motion, hands=HandParameters(np.zeros((2, 2, 6), np.float32)))
    assert fit_motion(still, SMPLH)[1] == ()


def test_expressions_are_cut_to_what_the_body_has_and_named_where_it_has_none():
    motion = dataclasses.replace(named_motion(BODY), expression=np.ones((2, 50), np.float32))
    assert fit_motion(motion, SMPLX, num_expression=10)[0].expression.shape == (2, 10)
    assert fit_motion(motion, SMPLX, num_expression=60)[0].expression.shape == (2, 50)
    fitted, ignored = fit_motion(motion, SMPLX)
    assert ignored == ("expressions",)
    assert fitted.expression is None
    assert fit_motion(dataclasses.replace(motion, expression=0 * motion.expression), SMPLX)[1] == ()


def test_a_motion_for_a_body_of_foreign_joint_names_keeps_its_order():
    motion = named_motion(SMPL)
    fitted, _ = fit_motion(motion, tuple(f"bone{i}" for i in range(24)))
    np.testing.assert_array_equal(fitted.poses, motion.poses)
