"""`gavatar-motion info|convert`."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from bvh_rigs import random_angles, write_bvh
from commands import run_motion as run

from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.motions import read_motion


@pytest.fixture
def clip(tmp_path):
    root = np.stack([np.linspace(0, 100, 31), np.full(31, 95.0), np.zeros(31)], 1)
    write_bvh(tmp_path / "clip.bvh", random_angles(31), root, fps=60)
    return tmp_path / "clip.bvh"


def test_info_counts_frames_joints_and_the_walk(clip, capsys):
    assert run("info", clip, "--json", "--set", "units=cm") == 0
    values = json.loads(capsys.readouterr().out)
    assert (values["frames"], values["joints"], values["skeleton"]) == (31, 52, "smplh")
    assert values["fps"] == pytest.approx(60, abs=0.01)
    assert values["walk_metres"] == pytest.approx(1, abs=1e-3)
    assert "left_middle1" in values["joints_at_rest"]
    assert run("info", clip) == 0
    assert "clip: 31 frames" in capsys.readouterr().out


def test_convert_resamples_and_reads_back_as_the_same_motion(clip, tmp_path, capsys):
    assert run("convert", clip, "-o", tmp_path / "a.npz") == 0
    mine, whole = read_motion(tmp_path / "a.npz", up="y"), read_motion(clip)
    np.testing.assert_array_equal(mine.poses, whole.poses)
    np.testing.assert_array_equal(mine.trans, whole.trans)
    assert mine.leg_length == pytest.approx(whole.leg_length)
    assert run("convert", clip, "-o", tmp_path / "b.npz", "--fps", "30") == 0
    half = read_motion(tmp_path / "b.npz", up="y")
    assert len(half) == 16
    there = matrix_from_axis_angle(half.poses.astype(float))
    # 1e-4: frame times of the file have 8 digits, so that every second frame is hit within 1e-6 of a frame
    np.testing.assert_allclose(there, matrix_from_axis_angle(whole.poses[::2].astype(float)), atol=1e-4)


def test_convert_to_a_smaller_skeleton_names_what_is_ignored(tmp_path, capsys):
    poses = np.zeros((2, 55, 3))
    poses[:, 22] = 0.1
    np.savez(tmp_path / "x.npz", poses=poses, mocap_framerate=30)
    assert run("convert", tmp_path / "x.npz", "-o", tmp_path / "s.npz", "--joints", "smpl") == 0
    assert "smpl has no jaw" in capsys.readouterr().out
    assert read_motion(tmp_path / "s.npz").poses.shape == (2, 24, 3)


def test_notes_name_options_as_they_are_written_on_the_command(tmp_path, capsys):
    np.savez(tmp_path / "x.npz", poses=np.zeros((3, 66)), trans=np.zeros((3, 3)))
    assert run("info", tmp_path / "x.npz") == 0
    assert "--set motion.fps=25 (or what it is)" in capsys.readouterr().out
    assert run("info", tmp_path / "x.npz", "--json") == 0
    assert "--set motion.fps=25" in json.loads(capsys.readouterr().out)["notes"][0]
    assert run("convert", tmp_path / "x.npz", "-o", tmp_path / "y.npz") == 0
    assert "--set motion.fps=25" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("info", "absent.npz"), "does not exist"),
        (("info", "clip.bvh", "--set", "up=q"), "--set motion.up=q: choose from"),
        (("info", "clip.bvh", "--set", "ups"), "expected"),
        (("convert", "clip.bvh", "-o", "a.bvh"), "suffix"),
        (("convert", "clip.bvh", "-o", "there.npz"), "exists"),
        (("convert", "clip.bvh", "-o", "a.npz", "--fps", "-3"), "--fps -3"),
    ],
)
def test_mistakes_are_one_sentence_exit_two_and_write_nothing(clip, tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.npz").write_bytes(b"mine")
    before = sorted(tmp_path.iterdir())
    assert run(*arguments) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "there.npz").read_bytes() == b"mine"


def test_the_command_loads_no_torch(clip):
    code = (
        f"import sys; from gavatar_runtime.cli.motion_files import main\n"
        f"try: main(['info', {str(clip)!r}])\nexcept SystemExit: pass\nsys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60).returncode == 0
