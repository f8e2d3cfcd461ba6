"""Fields of the SMPL family: whole poses, parts, hands, faces."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from motion_files import numbers, parts

from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.motion_file import write_motion
from gavatar_runtime.values.motion import joined
from gavatar_runtime.values.skeletons import SMPLX


def test_amass_smplx_parts_come_in_smplx_order(tmp_path):
    parts = {"root_orient": 3, "pose_body": 63, "pose_hand": 90, "pose_jaw": 3, "pose_eye": 6}
    arrays = {name: numbers(5, width, seed=i) for i, (name, width) in enumerate(parts.items())}
    np.savez(tmp_path / "a.npz", trans=numbers(5, 3), mocap_frame_rate=120.0, **arrays)
    motion = read_motion(tmp_path / "a.npz", up="y")
    assert motion.poses.shape == (5, 55, 3)
    flat = motion.poses.reshape(5, -1)
    order = ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand")
    np.testing.assert_array_equal(flat, np.concatenate([arrays[n] for n in order], 1))
    jaw = SMPLX.index("jaw")
    np.testing.assert_array_equal(motion.poses[:, jaw], arrays["pose_jaw"])


def test_parts_of_smplh_have_no_face_and_smplx_package_names_are_read(tmp_path):
    np.savez(
        tmp_path / "h.npz", global_orient=numbers(4, 3), body_pose=numbers(4, 63), transl=numbers(4, 3), fps=25,
        left_hand_pose=numbers(1, 45, seed=1), right_hand_pose=numbers(1, 45, seed=2), betas=np.zeros((4, 10)),
    )  # fmt: skip
    motion = read_motion(tmp_path / "h.npz", up="y")
    assert motion.poses.shape == (4, 52, 3)
    assert motion.fps == 25
    assert motion.betas.shape == (10,)
    np.testing.assert_array_equal(motion.poses[3, 22:37].reshape(-1), numbers(1, 45, seed=1)[0])  # one hand for all


def test_smpl_parts_have_24_joints_and_one_frame_may_lack_its_axis(tmp_path):
    np.savez(tmp_path / "s.npz", global_orient=numbers(3), body_pose=numbers(69), mocap_framerate=30)
    assert read_motion(tmp_path / "s.npz").poses.shape == (1, 24, 3)


@pytest.mark.parametrize("width", [1, 6, 12, 44])
def test_hand_coefficients_are_kept_until_a_body_is_known(tmp_path, width):
    left, right = numbers(2, width), numbers(1, width, seed=1)
    np.savez(tmp_path / "p.npz", **parts(left_hand_pose=left, right_hand_pose=right))
    motion = read_motion(tmp_path / "p.npz")
    assert motion.poses.shape == (2, 22, 3)
    assert (motion.hands.pca, motion.hands.relative) == (True, True)
    np.testing.assert_array_equal(motion.hands.values, np.stack([left, np.repeat(right, 2, 0)], 1))


@pytest.mark.parametrize(
    ("options", "fields", "expected"),
    [
        ({}, {}, None),
        ({"hand_mean": "flat"}, {}, None),
        ({"hand_mean": "mean"}, {}, (False, True)),
        ({"hands": "pca"}, {}, (True, True)),
        ({"hands": "pca", "hand_mean": "flat"}, {}, (True, False)),
        ({}, {"use_pca": True}, (True, True)),
        ({}, {"use_pca": True, "flat_hand_mean": True}, (True, False)),
        ({}, {"flat_hand_mean": False}, (False, True)),
        ({}, {"use_pca": False, "flat_hand_mean": np.array([True])}, None),
        ({"hands": "full"}, {"use_pca": True}, None),
    ],
)
def test_45_numbers_are_rotations_unless_the_file_or_an_option_says_otherwise(tmp_path, options, fields, expected):
    hands = {"left_hand_pose": numbers(2, 45), "right_hand_pose": numbers(2, 45, seed=1)}
    np.savez(tmp_path / "p.npz", **parts(**hands, **fields))
    motion = read_motion(tmp_path / "p.npz", **options)
    if expected is None:
        assert motion.hands is None
        np.testing.assert_array_equal(motion.poses[:, 22:37].reshape(2, 45), hands["left_hand_pose"])
    else:
        assert (motion.hands.pca, motion.hands.relative) == expected
        assert motion.poses.shape == (2, 22, 3)
        np.testing.assert_array_equal(motion.hands.values[:, 1], hands["right_hand_pose"])


@pytest.mark.parametrize(("width", "count"), [(78, 6), (90, 12)])
def test_compact_poses_of_smplh_end_in_coefficients(tmp_path, width, count):
    poses = numbers(3, width)
    np.savez(tmp_path / "p.npz", poses=poses, mocap_framerate=30)
    motion = read_motion(tmp_path / "p.npz", up="y")
    np.testing.assert_array_equal(motion.poses.reshape(3, 66), poses[:, :66])
    np.testing.assert_array_equal(motion.hands.values.reshape(3, -1), poses[:, 66:])
    assert motion.hands.values.shape == (3, 2, count)


def test_whole_poses_about_the_mean_hand_are_split_off_and_fingers_that_move_win_over_coefficients(tmp_path):
    poses = numbers(2, 165)
    np.savez(tmp_path / "p.npz", poses=poses, mocap_framerate=30)
    motion = read_motion(tmp_path / "p.npz", up="y", hand_mean="mean")
    assert not motion.poses[:, 25:].any()
    np.testing.assert_array_equal(motion.hands.values.reshape(2, 90), poses[:, 75:])
    np.testing.assert_array_equal(motion.poses[:, :25].reshape(2, 75), poses[:, :75])
    both = {"left_hand_pose": numbers(2, 6), "right_hand_pose": numbers(2, 6)}
    np.savez(tmp_path / "b.npz", poses=poses, mocap_framerate=30, **both)
    assert read_motion(tmp_path / "b.npz").hands is None
    poses[:, 75:] = 0
    np.savez(tmp_path / "c.npz", poses=poses, mocap_framerate=30, **both)
    assert read_motion(tmp_path / "c.npz").hands.values.shape == (2, 2, 6)


@pytest.mark.parametrize(
    ("fields", "options", "message"),
    [
        ({"left_hand_pose": numbers(2, 6), "right_hand_pose": numbers(2, 12)}, {}, "both hands must be alike"),
        ({"left_hand_pose": numbers(2, 6), "right_hand_pose": numbers(2, 6)}, {"hands": "full"}, "6 numbers a hand"),
        ({"left_hand_pose": numbers(2, 46), "right_hand_pose": numbers(2, 46)}, {}, "46 numbers a hand"),
        ({"left_hand_pose": numbers(3, 6), "right_hand_pose": numbers(3, 6)}, {}, "hand poses 3"),
        ({"pose_hand": numbers(2, 25)}, {}, "no two hands"),
        ({"pose_hand": numbers(2, 12), "use_pca": "yes"}, {}, "use_pca must be true or false"),
        ({"pose_hand": np.full((2, 12), np.nan)}, {}, "pose_hand holds NaN or infinite values at frames 0, 1"),
        ({"pose_hand": numbers(2, 12)}, {"hands": "pcs"}, "`hands=pcs`: choose from auto, full, pca"),
        ({"pose_hand": numbers(2, 12)}, {"hand_mean": "x"}, "`hand_mean=x`: choose"),
        ({"expression": numbers(3, 10)}, {}, r"expression has shape \(3, 10\), expected \(2, E\)"),
        ({"expression": np.full((2, 10), np.inf)}, {}, "expression holds NaN or infinite"),
        ({"expression": np.array([["x"]])}, {}, "expression holds <U1"),
        ({"jaw_pose": numbers(2, 4)}, {}, "jaw_pose holds 4 numbers a frame, expected 3"),
        ({"leye_pose": numbers(2, 3), "reye_pose": numbers(5, 3)}, {}, "different numbers of frames"),
    ],
)
def test_faulty_hands_and_faces_are_named(tmp_path, fields, options, message):
    np.savez(tmp_path / "f.npz", **parts(**fields))
    with pytest.raises(UserError, match=message):
        read_motion(tmp_path / "f.npz", **options)


@pytest.mark.parametrize("shape", [(4, 10), (1, 50), (10,)])
def test_expressions_are_read_a_row_a_frame_or_one_for_all(tmp_path, shape):
    values = numbers(*shape)
    np.savez(tmp_path / "e.npz", **parts(4, expression=values, jaw_pose=numbers(4, 3)))
    motion = read_motion(tmp_path / "e.npz")
    assert motion.poses.shape == (4, 55, 3)
    np.testing.assert_array_equal(motion.expression, np.broadcast_to(values, (4, shape[-1])))


def test_expressions_and_coefficients_are_resampled_and_written(tmp_path):
    hands = {"left_hand_pose": numbers(3, 6), "right_hand_pose": numbers(3, 6, seed=1), "flat_hand_mean": True}
    np.savez(tmp_path / "e.npz", **parts(3, expression=numbers(3, 10), **hands))
    motion = read_motion(tmp_path / "e.npz", up="y")
    double = motion.resampled(60)
    assert len(double) == 5
    for mine, theirs in ((double.expression, motion.expression), (double.hands.values, motion.hands.values)):
        np.testing.assert_array_equal(mine[::2], theirs)
        np.testing.assert_allclose(mine[1], (theirs[0] + theirs[1]) / 2, atol=1e-7)
    write_motion(tmp_path / "w.npz", double)
    back = read_motion(tmp_path / "w.npz", up="y")
    np.testing.assert_array_equal(back.poses, double.poses)
    np.testing.assert_array_equal(back.expression, double.expression)
    np.testing.assert_array_equal(back.hands.values, double.hands.values)
    assert (back.hands.pca, back.hands.relative) == (True, False)
    last = back.taken([4])
    assert (len(last), last.expression.shape, last.hands.values.shape) == (1, (1, 10), (1, 2, 6))
    assert last.resampled(30).expression.shape == (1, 10)  # one frame stays one
    twice = joined([back, back])
    assert (len(twice), twice.expression.shape, twice.hands.values.shape) == (10, (10, 10), (10, 2, 6))
    assert joined([back, dataclasses.replace(back, expression=None, hands=None)]).expression is None


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"global_orient": numbers(2, 3), "body_pose": numbers(2, 60)}, "body_pose holds 60 numbers a frame"),
        ({"global_orient": numbers(2, 4), "body_pose": numbers(2, 63)}, "global_orient holds 4 numbers"),
        ({"global_orient": numbers(3, 3), "body_pose": numbers(2, 63)}, "body_pose has 2 frames and global_orient 3"),
        ({"body_pose": numbers(2, 63)}, "'poses' is missing"),
        ({"global_orient": numbers(0, 3), "body_pose": numbers(0, 63)}, "no frame"),
        ({"global_orient": numbers(2, 3), "body_pose": np.full((2, 63), np.nan)}, "body_pose holds NaN"),
        ({"global_orient": numbers(2, 3), "body_pose": numbers(2, 63), "transl": numbers(2, 2)}, "transl has shape"),
    ],
)
def test_faulty_parts_are_named(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", mocap_framerate=30, **arrays)
    with pytest.raises(UserError, match=message) as raised:
        read_motion(tmp_path / "a.npz")
    assert "a.npz" in str(raised.value)
