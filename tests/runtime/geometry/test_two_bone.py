"""Inverse kinematics of a leg: the foot is where it shall be, or as near as a leg can come."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.geometry.two_bone import longest_reach, two_bone

THIGH, SHIN = np.array([0.06, -0.44, -0.01]), np.array([-0.05, -0.45, -0.04])
X = np.array([1.0, 0, 0])


def end_of(upper, lower, hinge, rotation, angle):
    """(..., 3) where the limb's end is, by forward kinematics."""
    axis = np.asarray(hinge) / max(np.linalg.norm(hinge), 1e-12)
    return np.einsum("...ab,...b->...a", rotation, upper + matrix_from_axis_angle(angle[..., None] * axis) @ lower)


def test_the_end_is_at_its_target_and_the_rotation_is_one():
    rng = np.random.default_rng(0)
    way = rng.normal(size=(500, 3))
    target = way / np.linalg.norm(way, axis=1, keepdims=True) * rng.uniform(0.2, 0.88, (500, 1))
    across = rng.normal(size=(500, 3))
    rotation, angle = two_bone(THIGH, SHIN, X, target, across)
    # a closed form in float64: a few rounding errors of lengths of a metre
    np.testing.assert_allclose(end_of(THIGH, SHIN, X, rotation, angle), target, atol=1e-9)
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, 1, 2), np.broadcast_to(np.eye(3), (500, 3, 3)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-12)
    assert ((angle >= 0) & (angle <= np.pi)).all()


def test_the_knee_bends_ahead_where_the_hinge_points_to_the_side():
    rotation, angle = two_bone(THIGH, SHIN, X, np.array([0, -0.7, 0.0]), X)
    assert 0.5 < angle < 2.5
    assert (rotation @ THIGH)[2] > 0.2  # the knee is ahead
    behind, _ = two_bone(THIGH, SHIN, X, np.array([0, -0.7, 0.0]), -X)
    assert (behind @ THIGH)[2] < -0.2


def test_a_straight_leg_is_straight_and_a_little_less_is_continuous():
    flat = np.array([1, 1, 0])  # hip, knee and ankle in the plane of the hinge: straight at rest
    reach = longest_reach(flat * THIGH, flat * SHIN, X)
    angles = [
        float(two_bone(flat * THIGH, flat * SHIN, X, np.array([0, -reach * share, 0]), X)[1])
        for share in (1, 1 - 1e-12, 1 - 1e-4)
    ]
    straight = angles[0]
    assert straight == pytest.approx(0, abs=1e-6)
    assert angles[1] - straight < 1e-4
    # the cosine law near a straight limb: shorter by a share s bends it by about 2 sqrt(2 s)
    assert angles[2] - straight == pytest.approx(2 * np.sqrt(2e-4), rel=0.1)


@pytest.mark.parametrize("factor", [1.0001, 2.0, 1e6])
def test_a_target_too_far_is_pointed_at(factor):
    reach = longest_reach(THIGH, SHIN, X)
    target = np.array([0.3, -0.9, 0.2]) / np.linalg.norm([0.3, -0.9, 0.2]) * reach
    rotation, angle = two_bone(THIGH, SHIN, X, factor * target, X)
    np.testing.assert_allclose(end_of(THIGH, SHIN, X, rotation, angle), target, atol=1e-9)


def test_a_target_too_near_folds_the_leg_and_is_pointed_at():
    rotation, angle = two_bone(np.array([0, -0.5, 0]), np.array([0, -0.3, 0]), X, np.array([0, 0, 0.1]), X)
    assert angle == pytest.approx(np.pi)
    np.testing.assert_allclose(
        end_of(np.array([0, -0.5, 0]), np.array([0, -0.3, 0]), X, rotation, angle), (0, 0, 0.2), atol=1e-9
    )


def test_a_target_on_the_hip_is_finite_and_where_the_rest_pose_points():
    rotation, angle = two_bone(THIGH, SHIN, X, np.zeros(3), X)
    end = end_of(THIGH, SHIN, X, rotation, angle)
    assert np.isfinite(rotation).all()
    rest = THIGH + SHIN
    np.testing.assert_allclose(end / np.linalg.norm(end), rest / np.linalg.norm(rest), atol=1e-9)


@pytest.mark.parametrize(
    ("upper", "lower"),
    [
        (np.zeros(3), SHIN),
        (THIGH, np.zeros(3)),
        (np.zeros(3), np.zeros(3)),
        (np.array([0.4, 0, 0]), SHIN),  # along the hinge
    ],
)
def test_a_bone_that_cannot_bend_does_not(upper, lower):
    rotation, angle = two_bone(upper, lower, X, np.array([[0, -0.5, 0], [0.1, 0.2, 0.3]]), X)
    assert (angle == 0).all()
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, 1, 2), np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-12
    )
    assert longest_reach(upper, lower, X) == pytest.approx(np.linalg.norm(upper + lower))


@pytest.mark.parametrize("across", [np.zeros(3), np.array([0, -1.0, 0])])
def test_a_hinge_that_is_told_nothing_useful_still_reaches(across):
    target = np.array([0, -0.6, 0])
    rotation, angle = two_bone(THIGH, SHIN, X, target, across)
    np.testing.assert_allclose(end_of(THIGH, SHIN, X, rotation, angle), target, atol=1e-9)


def test_no_frames_are_no_rotations():
    rotation, angle = two_bone(THIGH, SHIN, X, np.zeros((0, 3)), X)
    assert rotation.shape == (0, 3, 3)
    assert angle.shape == (0,)
