"""Arrays with an axis too few, too many or in another place; files that say how their rotations are written."""

from __future__ import annotations

import numpy as np
import pytest
from motion_files import assert_same_rotations, walk

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle, quaternion_from_axis_angle
from gavatar_runtime.motions import read_motion

FRAMES = 12
TRUTH = walk(FRAMES)
POSES, TRANS = TRUTH["poses"], TRUTH["trans"]
R = matrix_from_axis_angle(POSES.astype(np.float64))
Q = quaternion_from_axis_angle(POSES.astype(np.float64))
SIX = np.concatenate([R[..., 0], R[..., 1]], -1)
ONE = POSES[0]

SINGLE = {
    "(72,)": {"poses": ONE.reshape(-1)},
    "(24, 3)": {"poses": ONE},
    "(22, 3)": {"poses": ONE[:22]},
    "(24, 3, 3)": {"poses": R[0]},
    "(216,)": {"poses": R[0].reshape(-1)},
    "(24, 4)": {"poses": Q[0]},
    "(96,)": {"poses": Q[0].reshape(-1)},
    "(24, 6)": {"poses_6d": SIX[0]},
    "(1, 24, 3)": {"poses": POSES[:1]},
    "(1, 1, 72)": {"poses": POSES[:1].reshape(1, 1, 72)},
    "parts (3,), (63,)": {"global_orient": ONE[0], "body_pose": ONE[1:22].reshape(-1)},
    "parts (1, 3), (21, 3)": {"global_orient": ONE[:1], "body_pose": ONE[1:22]},
    "parts (1, 3, 3), (23, 3, 3)": {"global_orient": R[0, :1], "body_pose": R[0, 1:]},
    "parts (3, 3), (23, 3, 3)": {"global_orient": R[0, 0], "body_pose": R[0, 1:]},
}


@pytest.mark.parametrize("shape", SINGLE)
@pytest.mark.parametrize("trans", [None, (3,), (1, 3)])
def test_one_frame_needs_no_axis_of_frames(tmp_path, shape, trans):
    fields = dict(SINGLE[shape]) | ({} if trans is None else {"trans": TRANS[0].reshape(trans)})
    np.savez(tmp_path / "a.npz", **fields, betas=np.arange(10.0))
    motion = read_motion(tmp_path / "a.npz", up="y")
    assert_same_rotations(motion, POSES[:1])
    np.testing.assert_allclose(motion.trans, 0 if trans is None else TRANS[:1], atol=1e-6)
    np.testing.assert_array_equal(motion.betas, np.arange(10))
    assert motion.notes == ()


@pytest.mark.parametrize("array", [ONE.reshape(-1), ONE, R[0], Q[0], ONE[None]])
def test_one_frame_without_a_name_is_read_too(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    assert_same_rotations(read_motion(tmp_path / "a.npy", up="y"), POSES[:1])


@pytest.mark.parametrize("axes", [(12, 1, 72), (1, 12, 72), (12, 24, 3)])
def test_axes_of_one_are_passed_over(tmp_path, axes):
    np.savez(tmp_path / "a.npz", poses=POSES.reshape(axes), fps=30)
    motion = read_motion(tmp_path / "a.npz", up="y")
    assert_same_rotations(motion, POSES)
    assert motion.notes == ()


@pytest.mark.parametrize(
    ("array", "way_out"),
    [
        (POSES.reshape(12, 72).T, r"poses\.transpose\(1, 0\)"),
        (np.moveaxis(POSES, 0, -1), r"poses\.transpose\(2, 0, 1\)"),
    ],
)
def test_frames_in_the_last_axis_are_refused_with_the_way_out(tmp_path, array, way_out):
    np.savez(tmp_path / "a.npz", poses=array)
    with pytest.raises(UserError, match=rf"a\.npz: poses has shape .*last axis; store {way_out}"):
        read_motion(tmp_path / "a.npz")


SAID = {
    "rot6d": SIX, "6D": SIX, "xyzw": np.roll(Q, -1, -1), "wxyz": Q, "rotmat": R, "rotation matrix": R,
    "axis-angle": POSES, "aa": POSES, "degrees": np.degrees(POSES),
    "6d-rows": np.concatenate([R[..., 0, :], R[..., 1, :]], -1),
}  # fmt: skip


@pytest.mark.parametrize("word", SAID)
@pytest.mark.parametrize("key", ["rotation_format", "rot_repr"])
def test_a_word_in_the_file_says_how_rotations_are_written(tmp_path, word, key):
    np.savez(tmp_path / "a.npz", poses=SAID[word].reshape(12, -1), fps=30, **{key: word})
    motion = read_motion(tmp_path / "a.npz", up="y")
    assert_same_rotations(motion, POSES)
    assert motion.notes == ()


def test_other_words_say_nothing(tmp_path):
    np.savez(tmp_path / "a.npz", poses=POSES, fps=30, rotation_format="ours")
    assert_same_rotations(read_motion(tmp_path / "a.npz", up="y"), POSES)


def test_quaternions_whose_order_is_a_guess_are_noted(tmp_path):
    half = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])  # a quarter turn reads the same from both ends
    np.savez(tmp_path / "a.npz", poses=np.tile(half, (3, 24)), fps=30)
    motion = read_motion(tmp_path / "a.npz", up="y")
    assert any("in which order: wxyz is taken; `rotations=quaternion-wxyz` or" in n for n in motion.notes)


def test_rotations_beyond_half_a_turn_are_noted_as_degrees_perhaps(tmp_path):
    small = POSES.copy()
    small[:, 1:] = np.degrees(POSES[:, 1:] * 0.1)  # degrees of somebody who hardly moves
    np.savez(tmp_path / "a.npz", poses=small.reshape(12, -1), fps=30)
    notes = read_motion(tmp_path / "a.npz", up="y").notes
    assert any("half a turn" in note and "`rotations=degrees`" in note for note in notes)


@pytest.mark.parametrize("rate", ["30", b"30"])
def test_a_rate_may_be_written_as_text(tmp_path, rate):
    np.savez(tmp_path / "a.npz", poses=POSES.reshape(12, -1), fps=rate)
    assert read_motion(tmp_path / "a.npz", up="y").fps == 30
    np.savez(tmp_path / "a.npz", poses=POSES.reshape(12, -1), fps="fast")
    with pytest.raises(UserError, match="fps holds"):
        read_motion(tmp_path / "a.npz")


def test_a_pelvis_alone_is_no_motion(tmp_path):
    np.savez(tmp_path / "a.npz", global_orient=POSES[:, 0])
    with pytest.raises(UserError, match="this file holds global_orient"):
        read_motion(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.fbx", "Blender.*as BVH"), ("a.glb", "Blender"), ("a.usd", "Blender"), ("a.c3d", r"MoSh\+\+"),
        ("a.trc", "BVH"), ("a.asf", "amc2bvh"), ("a.csv", r"numpy\.savez"), ("a.mp4", "GVHMR"),
        ("a.zip", "unpack"), ("a.MP4", "pose est"),
        ("anna.gavatar", "--motion"), ("a.tar.gz", "unpack"), ("a.mat", r"numpy\.savez"), ("a.obj", "mesh"),
    ],
)  # fmt: skip
def test_files_of_other_formats_are_refused_with_the_way_out(name, words):
    with pytest.raises(UserError, match=rf"motion '{name}' cannot be read.*{words}") as raised:
        read_motion(name)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("suffix", [".bvh", ".npz", ".npy", ".pkl", ".pt"])
@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:ab", "git lfs pull"),
        (b"Kaydara FBX Binary  \0\x1a\0", "FBX"), (b"<!DOCTYPE html><html>", "web page"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
        (b"\0\0\0\x20ftypisom", "video"), (b"glTF\2\0\0\0", "glTF"),
    ],
)  # fmt: skip
def test_files_that_are_something_else_than_their_name_says_are_named(tmp_path, suffix, data, words):
    (tmp_path / f"a{suffix}").write_bytes(data)
    with pytest.raises(UserError, match=rf"a\{suffix}.* is .*{words}"):
        read_motion(tmp_path / f"a{suffix}")
