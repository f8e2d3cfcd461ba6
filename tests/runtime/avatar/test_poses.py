"""The forms in which a pose may be given, and what is said of those in which it may not."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.avatar.played_body import PlayedBody
from gavatar_runtime.avatar.poses import joint_rows, pose_of_parts
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.motions.fitting import HAND_DATA
from gavatar_runtime.values.body import Hands
from gavatar_runtime.values.skeletons import SKELETONS, SMPL, SMPLH, SMPLX


def normal(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape)


def body(names: tuple[str, ...], *, hands: Hands | None = None, rest: np.ndarray | None = None) -> PlayedBody:
    return PlayedBody(names, np.zeros((len(names), 3)), rest, hands, 0)


def hand_data(mean: float = 0.1) -> Hands:
    return Hands(np.full((2, 15, 3), mean), normal(2, 6, 45, seed=9))


# whole poses


@pytest.mark.parametrize("count", [len(names) for names in SKELETONS.values()])
@pytest.mark.parametrize("shape", ["rows", "flat", "one row", "one of rows"])
@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64, list])
def test_rows_and_flat_poses_of_every_skeleton_are_the_same_pose(count, shape, kind):
    rows = np.round(normal(count, 3), 1)
    shapes = {"rows": (count, 3), "flat": (3 * count,), "one row": (1, 3 * count), "one of rows": (1, count, 3)}
    given = rows.reshape(shapes[shape])
    got = joint_rows(given.tolist() if kind is list else given.astype(kind), SMPLH)
    assert got.dtype == np.float32
    expected = rows.astype(np.float16 if kind is np.float16 else np.float32).astype(np.float32)
    np.testing.assert_array_equal(got, expected)


def test_a_body_of_its_own_number_of_joints_takes_that():
    names = tuple(f"joint {j}" for j in range(7))
    assert joint_rows(np.zeros(21), names).shape == (7, 3)
    assert joint_rows(np.zeros(72, int), names).shape == (24, 3)


@pytest.mark.parametrize(
    "pose",
    [
        np.zeros(0), np.zeros(3), np.zeros((1, 3)), np.zeros(63), np.zeros(71), np.zeros((52, 4)), np.zeros((2, 72)),
        np.zeros((52, 3, 3)), np.zeros((2, 52, 3)), 0.0, [],
    ],
    ids=lambda pose: str(np.shape(pose)),
)  # fmt: skip
def test_a_pose_of_another_length_is_refused_with_the_lengths_that_are_taken(pose):
    with pytest.raises(WrongValue, match=r"pose has shape .*\(52, 3\) or \(156,\).* 22, 24, 52, 55 joints"):
        joint_rows(pose, SMPLH)


@pytest.mark.parametrize(
    "pose", [["a"] * 156, [[0, 0, 0], [0, 0]], np.zeros(156, complex), np.zeros(156, bool), {"pose": 1}, None]
)
def test_what_is_no_array_of_numbers_is_refused(pose):
    with pytest.raises(ValueError, match="pose is no array of numbers"):
        joint_rows(pose, SMPLH)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e39])
@pytest.mark.parametrize(("count", "joint"), [(52, "left_index1"), (24, "left_hand"), (55, "jaw")])
def test_a_number_that_is_none_in_float32_names_its_joint(count, joint, value):
    pose = np.zeros((count, 3))
    pose[22, 1] = value
    with pytest.raises(WrongValue, match=f"the pose of joint '{joint}' is NaN or infinite"):
        joint_rows(pose, SMPLH)


# parts


def test_parts_go_to_their_joints_and_the_others_rest():
    rest = np.zeros((55, 3))
    rest[30] = 0.25
    root, trunk, jaw = normal(3), normal(63, seed=1), normal(3, seed=2)
    pose, lacking = pose_of_parts(
        {"global_orient": root, "body_pose": trunk, "jaw_pose": jaw[None]}, body(SMPLX, rest=rest)
    )
    expected = rest.copy()
    expected[0], expected[1:22], expected[SMPLX.index("jaw")] = root, trunk.reshape(21, 3), jaw
    np.testing.assert_array_equal(pose, expected.astype(np.float32))
    assert lacking == ()
    assert (rest[0] == 0).all()  # the body's own is not written to


@pytest.mark.parametrize("shape", [(63,), (21, 3), (1, 63), (1, 21, 3)])
def test_a_part_may_be_flat_in_rows_or_a_batch_of_one(shape):
    trunk = np.arange(63.0)
    pose, _ = pose_of_parts({"body_pose": trunk.reshape(shape)}, body(SMPLH))
    np.testing.assert_array_equal(pose[1:22].reshape(-1), trunk)


def test_a_body_pose_of_smpl_has_two_joints_more():
    trunk = normal(69)
    pose, lacking = pose_of_parts({"body_pose": trunk}, body(SMPL))
    np.testing.assert_array_equal(pose[1:], trunk.reshape(23, 3).astype(np.float32))
    assert lacking == ()
    assert pose_of_parts({"body_pose": trunk}, body(SMPLH))[1] == ("left_hand", "right_hand")
    trunk[-6:] = 0
    assert pose_of_parts({"body_pose": trunk}, body(SMPLH))[1] == ()


def test_parts_of_joints_that_the_body_lacks_are_named_if_they_move():
    parts = {"jaw_pose": [0.1, 0, 0], "leye_pose": [0, 0, 0], "right_hand_pose": np.full(45, 0.2)}
    pose, lacking = pose_of_parts(parts, body(SMPL))
    assert lacking[0] == "jaw"
    assert len(lacking) == 16
    assert "left_eye_smplhf" not in lacking
    assert not pose.any()


@pytest.mark.parametrize(("side", "part"), [(0, "left_hand_pose"), (1, "right_hand_pose")])
def test_45_numbers_of_a_hand_are_rotations_about_the_flat_hand(side, part):
    values = normal(45)
    pose, _ = pose_of_parts({part: values}, body(SMPLH, hands=hand_data()))
    start = 22 + 15 * side
    np.testing.assert_array_equal(pose[start : start + 15].reshape(-1), values.astype(np.float32))
    assert not np.delete(pose, slice(start, start + 15), 0).any()


@pytest.mark.parametrize("count", [1, 6])
def test_fewer_are_coefficients_about_the_mean_hand_of_the_body(count):
    hands, values = hand_data(), normal(count)
    pose, lacking = pose_of_parts({"right_hand_pose": values}, body(SMPLH, hands=hands))
    expected = hands.mean[1] + (values @ hands.components[1, :count]).reshape(15, 3)
    np.testing.assert_allclose(pose[37:], expected, atol=2e-6)  # float32 of six summed coefficients
    assert lacking == ()


def test_the_words_of_smplx_say_how_a_hand_is_meant():
    hands, values = hand_data(), normal(45).astype(np.float32)
    about_mean, _ = pose_of_parts({"left_hand_pose": values, "flat_hand_mean": False}, body(SMPLH, hands=hands))
    np.testing.assert_allclose(about_mean[22:37].reshape(-1), values + 0.1, rtol=1e-6)
    few = values[:6]
    flat, _ = pose_of_parts({"left_hand_pose": few, "flat_hand_mean": True}, body(SMPLH, hands=hands))
    np.testing.assert_allclose(flat[22:37].reshape(-1), few @ hands.components[0], rtol=1e-5, atol=1e-6)
    whole = Hands(hands.mean, normal(2, 45, 45))
    coefficients, _ = pose_of_parts({"left_hand_pose": values, "use_pca": True}, body(SMPLH, hands=whole))
    expected = 0.1 + values @ whole.components[0]
    np.testing.assert_allclose(coefficients[22:37].reshape(-1), expected, rtol=1e-5, atol=1e-5)


def test_coefficients_of_a_body_without_hand_data_are_named_if_they_move():
    assert pose_of_parts({"left_hand_pose": np.ones(6)}, body(SMPLH))[1] == (HAND_DATA,)
    assert pose_of_parts({"left_hand_pose": np.zeros(6)}, body(SMPLH))[1] == ()


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"bodypose": np.zeros(63)}, "a pose has no part 'bodypose'.*did you mean 'body_pose'"),
        ({"betas": np.zeros(10)}, "shape that it was trained with: leave `betas` out"),
        ({"body_pose": np.zeros(60)}, "body_pose holds 60 numbers, expected 63 or 69"),
        ({"body_pose": np.zeros((2, 63))}, "body_pose holds 126 numbers"),
        ({"global_orient": np.zeros((3, 3))}, "global_orient holds 9 numbers, expected 3"),
        ({"jaw_pose": []}, "jaw_pose holds 0 numbers"),
        ({"reye_pose": "left"}, "reye_pose is no array of numbers"),
        ({"body_pose": np.full(63, np.nan)}, "body_pose holds NaN or infinite values"),
        ({"left_hand_pose": np.zeros(7)}, "left_hand_pose: this body has 6 hand components, not 7"),
        ({"left_hand_pose": np.zeros(6), "use_pca": False}, "left_hand_pose holds 6 numbers, expected 45"),
    ],
)
def test_a_part_that_is_none_is_refused_by_its_name(parts, message):
    with pytest.raises(UserError, match=message):
        pose_of_parts(parts, body(SMPLX, hands=hand_data()))
