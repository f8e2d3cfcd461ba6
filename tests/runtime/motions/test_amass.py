"""AMASS files, and which way is up in them."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_files import amass, nan_from, numbers

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.skeletons import SMPLX


def test_an_amass_file_reads_back_what_was_written(tmp_path):
    poses, trans = np.random.default_rng(1).normal(0, 0.3, (7, 156)), np.ones((7, 3))
    motion = read_motion(amass(tmp_path / "clip.npz", poses=poses, trans=trans), up="y")
    assert (motion.name, motion.fps, len(motion)) == ("clip", 60, 7)
    assert motion.poses.dtype == motion.trans.dtype == np.float32
    np.testing.assert_array_equal(motion.poses.reshape(7, 156), poses.astype(np.float32))
    np.testing.assert_array_equal(motion.trans, trans.astype(np.float32))
    assert motion.betas.shape == (16,)


@pytest.mark.parametrize("joints", [1, 22, 24, 52, 55])
@pytest.mark.parametrize("frames", [1, 3])
def test_any_number_of_joints_and_frames_is_read(tmp_path, joints, frames):
    file = amass(tmp_path / "a.npz", poses=np.zeros((frames, 3 * joints)), trans=np.zeros((frames, 3)))
    assert read_motion(file).poses.shape == (frames, joints, 3)


def test_joint_rotations_may_stand_in_an_axis_of_their_own(tmp_path):
    file = amass(tmp_path / "a.npz", poses=np.zeros((4, 52, 3)))
    assert read_motion(file).poses.shape == (4, 52, 3)


def test_the_other_spelling_of_the_frame_rate_and_absent_optional_keys_are_read(tmp_path):
    changes = {"mocap_framerate": None, "mocap_frame_rate": np.array([120]), "betas": None, "trans": None}
    motion = read_motion(amass(tmp_path / "a.npz", **changes))
    assert motion.fps == 120
    assert motion.betas is None
    np.testing.assert_array_equal(motion.trans, np.zeros((4, 3)))


def test_an_object_array_among_the_extras_does_not_hinder(tmp_path):
    assert len(read_motion(amass(tmp_path / "a.npz", labels=np.array([{"a": 1}], object)))) == 4


def test_amass_files_of_smplx_with_all_that_they_hold_are_read(tmp_path):
    """The keys of AMASS's *_stageii.npz of 2022 and later, some of them objects."""
    parts = {"root_orient": 3, "pose_body": 63, "pose_jaw": 3, "pose_eye": 6, "pose_hand": 90}
    arrays = {name: numbers(4, width, seed=i).astype(float) for i, (name, width) in enumerate(parts.items())}
    np.savez(
        tmp_path / "a_stageii.npz", gender="neutral", surface_model_type=np.array("smplx", object),
        mocap_frame_rate=120.0, mocap_time_length=4 / 120, markers_latent=numbers(53, 3),
        latent_labels=np.array(["ARIEL"] * 53), markers_latent_vids=np.array({"ARIEL": 1}, object),
        trans=numbers(4, 3), poses=np.concatenate(list(arrays.values()), 1), betas=numbers(16), num_betas=16, **arrays,
    )  # fmt: skip
    motion = read_motion(tmp_path / "a_stageii.npz", up="y")
    assert (motion.poses.shape, motion.fps, motion.betas.shape) == ((4, 55, 3), 120, (16,))
    assert motion.hands is None
    np.testing.assert_array_equal(motion.poses[:, SMPLX.index("jaw")], arrays["pose_jaw"].astype(np.float32))
    np.testing.assert_array_equal(motion.poses[:, 25:].reshape(4, 90), arrays["pose_hand"].astype(np.float32))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": None}, "'poses' is missing"),
        ({"poses": np.zeros((4, 155))}, r"\(4, 155\), expected \(T, 3J\)"),
        ({"poses": np.zeros(156)}, "expected"),
        ({"poses": np.zeros((4, 0))}, "expected"),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, "no frame"),
        ({"poses": nan_from(2, (4, 156))}, "poses holds NaN .* at frames 2, 3"),
        ({"poses": np.full((4, 156), 1e60)}, "poses holds NaN or infinite .* frames 0 to 3"),
        ({"poses": np.full((4, 156), "x")}, "poses holds <U1 values"),
        ({"poses": np.array([{}] * 4, object)}, "poses is not a plain array"),
        ({"trans": np.zeros((3, 3))}, r"trans has shape \(3, 3\), expected \(4, 3\)"),
        ({"trans": nan_from(3, (4, 3))}, "trans .* frame 3"),
        ({"betas": np.array([np.inf])}, "betas holds NaN"),
        ({"mocap_framerate": np.float64(0)}, "positive"),
        ({"mocap_framerate": np.float64("nan")}, "positive"),
        ({"mocap_framerate": np.ones(2)}, "one positive number"),
    ],
)
def test_a_faulty_amass_file_is_one_sentence_that_names_it(tmp_path, changes, message):
    with pytest.raises(UserError, match=message) as raised:
        read_motion(amass(tmp_path / "clip.npz", **changes))
    assert "clip.npz" in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 cut short"])
def test_a_file_that_is_no_npz_is_refused(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(UserError, match=r"a\.npz is .*damaged or not an \.npz"):
        read_motion(tmp_path / "a.npz")


def test_a_truncated_npz_and_a_bare_npy_are_refused(tmp_path):
    whole = amass(tmp_path / "whole.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    np.save(tmp_path / "bare.npy", np.zeros(3))
    (tmp_path / "bare.npy").rename(tmp_path / "bare.npz")
    for name in ("cut.npz", "bare.npz"):
        with pytest.raises(UserError, match=name):
            read_motion(tmp_path / name)


def test_a_pickle_in_an_npz_is_never_executed(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "exploded"), "w"))

    bomb = np.empty(1, object)
    bomb[0] = Bomb()
    file = amass(tmp_path / "a.npz", poses=bomb)
    with pytest.raises(UserError):
        read_motion(file)
    assert not (tmp_path / "exploded").exists()


def test_no_warning_is_raised_by_a_plain_file(tmp_path):
    np.savez(tmp_path / "a.npz", poses=numbers(2, 66), mocap_framerate=30)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_motion(tmp_path / "a.npz")


def z_up(poses, trans):
    """The same motion in a z-up world, as AMASS stores it: x stays, y becomes z."""
    C = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    from gavatar_runtime.geometry.rotations import axis_angle_from_matrix

    poses = poses.copy().reshape(len(poses), -1, 3)
    poses[:, 0] = axis_angle_from_matrix(C @ matrix_from_axis_angle(poses[:, 0]))
    return poses.reshape(len(poses), -1), trans @ C.T


@settings(deadline=None)  # a busy machine is no fault
@given(st.floats(-3.1, 3.1), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_person_within_40_degrees_of_upright_in_a_z_up_file_comes_out_y_up(tmp_path_factory, yaw, lean_x, lean_z):
    from gavatar_runtime.geometry.rotations import axis_angle_from_matrix

    turn = matrix_from_axis_angle(np.array([0, yaw, 0])) @ matrix_from_axis_angle(np.array([lean_x, 0, lean_z]))
    poses, trans = np.zeros((2, 66)), np.array([[1.0, 2, 3], [4, 5, 6]])
    poses[:, :3] = axis_angle_from_matrix(turn)
    other_poses, other_trans = z_up(poses, trans)
    file = amass(tmp_path_factory.mktemp("z") / "a.npz", poses=other_poses, trans=other_trans)
    read, kept = read_motion(file), read_motion(file, up="y")
    # 2e-5: float32 axis-angle of up to pi radians, there and back through a matrix
    np.testing.assert_allclose(matrix_from_axis_angle(read.poses[0, 0].astype(float)), turn, atol=2e-5)
    np.testing.assert_allclose(read.trans, trans, atol=1e-6)
    np.testing.assert_array_equal(kept.trans, other_trans.astype(np.float32))


def test_a_y_up_file_is_left_as_it_is(tmp_path):
    poses = np.zeros((3, 66))
    poses[:, 1] = [0, np.pi, 2 * np.pi]
    motion = read_motion(amass(tmp_path / "a.npz", poses=poses, trans=np.ones((3, 3))))
    np.testing.assert_array_equal(motion.poses.reshape(3, 66), poses.astype(np.float32))


def test_a_motion_in_the_axes_of_a_camera_is_turned_upright(tmp_path):
    flip = np.diag([1.0, -1, -1])
    turn = matrix_from_axis_angle(np.array([0.1, 0.7, 0.2]))
    poses = np.zeros((2, 72))
    poses[:, :3] = axis_angle_from_matrix(flip @ turn)
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.array([[1.0, 2, 3]] * 2), mocap_framerate=30)
    motion = read_motion(tmp_path / "a.npz")
    # 2e-6: float32 angles near pi
    np.testing.assert_allclose(matrix_from_axis_angle(motion.poses[0, 0].astype(float)), turn, atol=2e-6)
    np.testing.assert_allclose(motion.trans[0], [1, -2, -3])


def test_an_unknown_vertical_axis_or_option_lists_the_choices(tmp_path):
    file = amass(tmp_path / "a.npz")
    with pytest.raises(UserError, match="auto, y, z"):
        read_motion(file, up="x")
    with pytest.raises(UserError, match=r"no option 'ups'.*did you mean 'up'"):
        read_motion(file, ups="z")
    with pytest.raises(UserError, match="fps"):
        read_motion(file, fps="fast")
