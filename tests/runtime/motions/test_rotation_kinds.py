"""Rotations in every way that files write them come out as axis-angle."""

from __future__ import annotations

import numpy as np
import pytest
from motion_files import amass, assert_same_rotations, walk

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle, quaternion_from_axis_angle
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.rotation_kinds import KINDS, axis_angle

TRUTH = walk(12)["poses"].astype(np.float64)
R = matrix_from_axis_angle(TRUTH)
Q = quaternion_from_axis_angle(TRUTH)
WAYS = {
    "matrices": R,
    "matrices in a row": R.reshape(12, 24, 9),
    "matrices in one row": R.reshape(12, -1),
    "matrices of float16": R.astype(np.float16),
    "quaternions, w first": Q,
    "quaternions, w last": np.roll(Q, -1, -1),
    "quaternions in one row": Q.reshape(12, -1),
    "quaternions of the other sign": -Q,
    "axis-angle": TRUTH,
    "axis-angle in one row": TRUTH.reshape(12, -1),
}


@pytest.mark.parametrize("way", WAYS)
def test_rotations_are_told_by_their_shape_and_values(tmp_path, way):
    motion = read_motion(amass(tmp_path / "a.npz", poses=WAYS[way], trans=None), up="y")
    if "float16" in way:  # eleven bits
        np.testing.assert_allclose(matrix_from_axis_angle(motion.poses.astype(float)), R, atol=2e-3)
    else:
        assert_same_rotations(motion, TRUTH, 24)


@pytest.mark.parametrize("way", ["matrices", "quaternions, w first", "axis-angle"])
def test_parts_may_be_of_any_kind(tmp_path, way):
    poses = WAYS[way]
    np.savez(tmp_path / "a.npz", global_orient=poses[:, :1], body_pose=poses[:, 1:22], jaw_pose=poses[:, 23:24], fps=30)
    motion = read_motion(tmp_path / "a.npz", up="y")
    assert motion.poses.shape == (12, 55, 3)
    assert_same_rotations(motion, TRUTH)


SIX = {
    "6d": (R[..., :2].swapaxes(-1, -2).reshape(12, 24, 6), R[..., :2]),
    "6d-rows": (R[..., :2, :].reshape(12, 24, 6),),
}


@pytest.mark.parametrize(("kind", "array"), [(kind, array) for kind, arrays in SIX.items() for array in arrays])
@pytest.mark.parametrize("in_one_row", [False, True])
def test_six_numbers_are_read_where_it_is_said_how(tmp_path, kind, array, in_one_row):
    array = array.reshape(12, -1) if in_one_row and array.ndim == 3 else array
    path = amass(tmp_path / "a.npz", poses=array, trans=None)
    with pytest.raises(UserError, match=r"joints in 6D, .*`rotations=6d` or 6d-rows"):
        read_motion(path)
    assert_same_rotations(read_motion(path, up="y", rotations=kind), TRUTH, 24)


def test_a_name_may_say_that_it_is_6d(tmp_path):
    np.savez(tmp_path / "a.npz", poses_6d=SIX["6d"][0], fps=30)
    assert_same_rotations(read_motion(tmp_path / "a.npz", up="y"), TRUTH, 24)
    np.savez(tmp_path / "b.npz", global_orient_6d=SIX["6d"][0][:, 0], body_pose_6d=SIX["6d"][0][:, 1:22], fps=30)
    assert_same_rotations(read_motion(tmp_path / "b.npz", up="y"), TRUTH)


@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi - 1e-6, np.pi])
@pytest.mark.parametrize("kind", ["matrix", "quaternion-wxyz", "quaternion-xyzw", "6d", "6d-rows", "degrees"])
def test_no_turn_and_half_a_turn_are_exact(angle, kind):
    turn = np.array([[[0, angle, 0], [0, 0, 0]]])
    M, q = matrix_from_axis_angle(turn), quaternion_from_axis_angle(turn)
    written = {
        "matrix": M, "quaternion-wxyz": q, "quaternion-xyzw": np.roll(q, -1, -1), "degrees": np.degrees(turn),
        "6d": M[..., :2].swapaxes(-1, -2).reshape(1, 2, 6), "6d-rows": M[..., :2, :].reshape(1, 2, 6),
    }[kind]  # fmt: skip
    values, told = axis_angle("x", written, kind)
    assert told == kind
    np.testing.assert_allclose(matrix_from_axis_angle(values.reshape(1, 2, 3)), M, atol=1e-9)


def test_what_is_not_of_the_kind_is_named(tmp_path):
    path = amass(tmp_path / "a.npz", poses=2 * R, trans=None)
    with pytest.raises(UserError, match=r"a\.npz: poses holds matrices that are no rotations"):
        read_motion(path)
    mirrored = R * np.array([1, 1, -1.0])
    with pytest.raises(UserError, match="no rotations"):
        read_motion(amass(tmp_path / "a.npz", poses=mirrored, trans=None))
    with pytest.raises(UserError, match=r"expected \(T, 4J\), 4 numbers a joint of quaternion-wxyz"):
        read_motion(amass(tmp_path / "a.npz", poses=np.zeros((4, 66)), trans=None), rotations="quaternion-wxyz")
    with pytest.raises(UserError, match=r"`rotations=euler`: choose from auto, axis-angle"):
        read_motion(amass(tmp_path / "a.npz"), rotations="euler")
    assert KINDS[0] == "auto"
