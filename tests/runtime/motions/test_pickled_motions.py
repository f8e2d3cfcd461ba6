"""Motions in pickles and files of torch.save: AIST++, EDGE, GaussianAvatar; nothing in them runs."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch
from motion_files import numbers

from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion


def test_an_aist_motion_is_scaled_to_metres_at_60_frames(tmp_path):
    content = {"smpl_poses": numbers(6, 72), "smpl_trans": numbers(6, 3, scale=90), "smpl_scaling": np.array([93.78])}
    (tmp_path / "gBR.pkl").write_bytes(pickle.dumps(content))
    motion = read_motion(tmp_path / "gBR.pkl", up="y")
    assert (motion.fps, motion.poses.shape) == (60, (6, 24, 3))
    np.testing.assert_allclose(motion.trans, content["smpl_trans"] / 93.78, rtol=1e-6)


def test_a_dance_by_edge_runs_at_30_frames_in_metres_and_is_turned_upright(tmp_path):
    turn = np.tile([np.pi / 2, 0, 0], (6, 1))  # z-up
    content = {"smpl_poses": np.concatenate([turn, numbers(6, 69)], 1), "smpl_trans": numbers(6, 3),
               "full_pose": numbers(6, 24, 3)}  # fmt: skip
    (tmp_path / "edge.pkl").write_bytes(pickle.dumps(content))
    motion = read_motion(tmp_path / "edge.pkl")
    assert (motion.fps, len(motion)) == (30, 6)
    np.testing.assert_allclose(motion.poses[:, 0], 0, atol=1e-6)
    np.testing.assert_allclose(motion.trans, content["smpl_trans"] @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-6)


def test_numpy_arrays_in_a_pth_are_read_as_tensors_are(tmp_path):
    content = {"beta": np.zeros((1, 10)), "body_pose": numbers(3, 72), "trans": numbers(3, 3)}
    torch.save(content, tmp_path / "smpl_parms.pth")
    motion = read_motion(tmp_path / "smpl_parms.pth", up="y")
    np.testing.assert_array_equal(motion.poses.reshape(3, 72), content["body_pose"])


@pytest.mark.parametrize("scaling", [np.array([0.0]), np.array([np.nan]), np.ones(2), np.array(["x"])])
def test_a_senseless_aist_scaling_is_named(tmp_path, scaling):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"smpl_poses": numbers(2, 72), "smpl_scaling": scaling}))
    with pytest.raises(UserError, match=r"a\.pkl.*smpl_scaling"):
        read_motion(tmp_path / "a.pkl")


@pytest.mark.parametrize(
    ("content", "message"),
    [([1, 2], r"shape \(2,\)"), ("x", "a str"), (None, "a NoneType"), ([], "a list"), ({}, "nothing")],
)
def test_a_pickle_of_something_else_is_named(tmp_path, content, message):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(content))
    with pytest.raises(UserError, match=rf"a\.pkl.*{message}"):
        read_motion(tmp_path / "a.pkl")


class Bomb:
    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return (open, (self.path, "w"))


@pytest.mark.parametrize("suffix", [".pkl", ".pth"])
def test_a_hostile_file_is_refused_and_runs_nothing(tmp_path, suffix):
    content = {"body_pose": torch.zeros(2, 72), "bomb": Bomb(tmp_path / "exploded")}
    if suffix == ".pth":
        torch.save(content, tmp_path / "a.pth")
    else:
        (tmp_path / "a.pkl").write_bytes(pickle.dumps({"smpl_poses": numbers(2, 72), "bomb": content["bomb"]}))
    with pytest.raises(UserError, match=f"a{suffix} asks for .*open.*nothing ran"):
        read_motion(tmp_path / f"a{suffix}")
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize("width", [72, 165])
def test_upstream_parameters_are_read(tmp_path, width):
    content = {"beta": torch.zeros(1, 10), "body_pose": torch.randn(3, width) * 0.1, "trans": torch.randn(3, 3)}
    torch.save(content, tmp_path / "smpl_parms.pth")
    motion = read_motion(tmp_path / "smpl_parms.pth", up="y")
    assert motion.poses.shape == (3, width // 3, 3)
    assert motion.betas.shape == (10,)
    assert motion.fps == 30
    np.testing.assert_array_equal(motion.trans, content["trans"].numpy())
