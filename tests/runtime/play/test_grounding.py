"""Standing on the floor: `gavatar-play --ground`, `gavatar-motion convert --on AVATAR --ground`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bvh_rigs import MIXAMO, write_bvh
from commands import run_motion, run_play
from make_bundle import free_body, make_bundle
from places import SHARED

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.grounding import grounded, lowest_points
from gavatar_runtime.values.motion import Motion


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return make_bundle(tmp_path_factory.mktemp("avatar") / "a.gavatar", count=3000)


@pytest.fixture(scope="module")
def avatar(bundle):
    return Avatar(bundle)


def test_a_standing_person_is_put_with_the_soles_on_the_floor(avatar):
    poses, trans = np.zeros((4, 52, 3), np.float32), np.tile(np.float32([0.3, 5.0, -1.0]), (4, 1))
    moved, lift = grounded(avatar, Motion(poses, trans, 30.0))
    means = avatar.gaussians(*moved.at(0)).means
    assert abs(means[:, 1].min()) < 1e-5
    np.testing.assert_array_equal(moved.trans[:, [0, 2]], trans[:, [0, 2]])
    assert lift == pytest.approx(float(moved.trans[0, 1] - 5), abs=1e-5)
    lowest = free_body().posed(np.zeros((52, 3)))[0][:, 1].min()
    assert lift == pytest.approx(-5 - lowest, abs=0.01)  # centres of triangles against vertices
    one = Motion(poses[:1], trans[:1], 30.0)
    assert grounded(avatar, one)[1] == pytest.approx(lift)


def test_jumps_stay_jumps_and_one_slip_below_the_floor_does_not_lift_the_rest(avatar):
    trans = np.zeros((60, 3), np.float32)
    trans[10:20, 1] = 0.4
    trans[30, 1] = -0.2
    heights = lowest_points(avatar, grounded(avatar, Motion(np.zeros((60, 52, 3), np.float32), trans, 30.0))[0])
    np.testing.assert_allclose(heights[:10], 0, atol=1e-5)
    np.testing.assert_allclose(heights[10:20], 0.4, atol=1e-5)
    np.testing.assert_allclose(heights[30], -0.2, atol=1e-5)


def test_a_person_on_the_back_lies_on_the_floor(avatar):
    poses = np.zeros((1, 52, 3), np.float32)
    poses[:, 0, 0] = -np.pi / 2
    moved, _ = grounded(avatar, Motion(poses, np.zeros((1, 3), np.float32), 30.0))
    assert abs(avatar.gaussians(*moved.at(0)).means[:, 1].min()) < 1e-5


def test_the_command_converts_for_an_avatar_and_grounds(bundle, avatar, tmp_path, capsys):
    root = np.stack([np.zeros(8), np.full(8, 250.0), np.zeros(8)], 1)
    write_bvh(tmp_path / "a.bvh", np.zeros((8, len(MIXAMO), 3)), root)
    assert run_motion("convert", tmp_path / "a.bvh", "-o", tmp_path / "a.npz", "--ground") == 2
    assert "--ground needs --on AVATAR" in capsys.readouterr().err
    assert run_motion("convert", tmp_path / "a.bvh", "-o", tmp_path / "a.npz", "--on", bundle, "--joints", "smpl") == 2
    assert run_motion("convert", tmp_path / "a.bvh", "-o", tmp_path / "a.npz", "--on", bundle, "--ground") == 0
    assert "on the floor" in capsys.readouterr().out
    motion, ignored = avatar.fit(read_motion(tmp_path / "a.npz", up="y"))
    assert ignored == ()
    np.testing.assert_allclose(lowest_points(avatar, motion), 0, atol=1e-5)


def test_the_player_takes_both_options(bundle, tmp_path):
    write_bvh(tmp_path / "a.bvh", np.zeros((2, len(MIXAMO), 3)), np.zeros((2, 3)))
    arguments = ["--rest", "first-frame", "--out", tmp_path / "s.png", "--size", 48, "--rasterizer", "numpy", "--quiet"]
    assert run_play(bundle, "--motion", tmp_path / "a.bvh", "--ground", *arguments) == 0
    assert run_play(bundle, "--motion", "turn", *arguments) == 2


@pytest.mark.shared
@pytest.mark.parametrize("name", ["dab", "jumping", "jumping_jacks", "wave_hello", "zombie"])
def test_the_shared_clips_stand_on_the_floor(avatar, name):
    path = Path(SHARED / "motions" / f"{name}.bvh")
    if not path.exists():
        pytest.skip(f"{path} is absent")
    motion, _ = avatar.fit(read_motion(path))
    heights = lowest_points(avatar, grounded(avatar, motion)[0])
    print(name, np.quantile(heights, [0, 0.05, 0.5, 1]))
    # the foot on the floor stays within centimetres of it, another body's legs as they are
    assert np.abs(np.quantile(heights, [0.05, 0.5])).max() < 0.06
    assert heights.min() > -0.15
    if name.startswith("jumping"):
        assert heights.max() > 0.1
