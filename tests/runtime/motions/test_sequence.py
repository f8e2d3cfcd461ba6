"""Motions one after another: how long, how smooth, and where the person goes on from."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gavatar_runtime.errors import WrongValue
from gavatar_runtime.motions import motions_named, read_motion, read_motions
from gavatar_runtime.motions.sequence import in_sequence
from gavatar_runtime.values.motion import Motion


def pose(name="pose", angle=0.0, frames=1, fps=30.0, joints=3, **fields) -> Motion:
    """All joints turned by `angle` about x, standing still."""
    poses = np.zeros((frames, joints, 3), np.float32)
    poses[..., 0] = angle
    return Motion(poses, np.zeros((frames, 3), np.float32), fps, name=name, **fields)


def largest_turn(motion: Motion) -> float:
    """Radians, the most that a joint turns from a frame to the next, relative to its parent."""
    rotations = Rotation.from_rotvec(motion.poses.reshape(-1, 3).astype(float))
    q = rotations.as_quat().reshape(*motion.poses.shape[:2], 4)
    cosine = np.abs(np.sum(q[1:] * q[:-1], -1)).clip(0, 1)
    return float((2 * np.arccos(cosine)).max())


def test_it_lasts_as_long_as_its_motions_less_the_blends():
    walk, wave, idle = (read_motion(n) for n in ("walk", "wave", "idle"))
    whole = in_sequence([walk, wave, idle], 0.4)
    assert len(whole) == len(walk) + len(wave) + len(idle) - 2 * 12
    assert whole.name == "walk_wave_idle"
    np.testing.assert_array_equal(whole.poses[: len(walk) - 12], walk.poses[:-12])
    # all but the pelvis, which goes on facing where it did: the wave's turns by a third of a degree
    np.testing.assert_allclose(whole.poses[-(len(idle) - 12) :, 1:], idle.poses[12:, 1:], atol=1e-5)
    np.testing.assert_allclose(whole.poses[-(len(idle) - 12) :, 0], idle.poses[12:, 0], atol=0.1)


def test_no_joint_jumps_where_motions_meet():
    parts = [read_motion(n) for n in ("walk", "dance", "stretch", "run", "jump")]
    alone = max(largest_turn(part) for part in parts)
    # what the poses differ by at most is pi; over 12 frames, at most 15/8 of an even pace: 0.49, and both motions' own
    assert largest_turn(in_sequence(parts, 0.4)) < 15 / 8 * np.pi / 13 + 2 * alone
    assert largest_turn(in_sequence(parts, 0.4)) < 0.6
    whole = in_sequence(parts, 0.4)
    step = np.linalg.norm(np.diff(whole.trans, axis=0), axis=1).max()
    assert step < 2 * max(np.linalg.norm(np.diff(p.trans, axis=0), axis=1).max() for p in parts)


def test_the_person_goes_on_from_where_they_are_and_as_they_face():
    ahead = np.zeros((31, 3), np.float32)
    ahead[:, 2] = np.arange(31) / 30  # a metre along +z
    turn = pose(frames=31)
    turn.poses[:, 0] = 0
    turn.poses[:, 0, 1] = np.linspace(0, np.pi / 2, 31)
    walk = dataclasses.replace(pose(frames=31), trans=ahead)
    walk.poses[:] = 0
    whole = in_sequence([walk, turn, walk], 0.0)
    assert len(whole) == 93
    # a metre along z, a quarter turn to the left, a metre along x
    np.testing.assert_allclose(whole.trans[30], (0, 0, 1), atol=1e-6)
    end = whole.trans[-1] - whole.trans[61]
    # the turn goes on for the one frame between two motions: 3 degrees
    np.testing.assert_allclose(end, (1, 0, 0), atol=0.06)
    blended = in_sequence([walk, walk], 0.5)
    np.testing.assert_allclose(np.diff(blended.trans[:, 2]), 1 / 30, atol=1e-5)  # one pace throughout
    np.testing.assert_allclose(blended.trans[:, 0], 0, atol=1e-6)


def test_the_pelvis_turns_with_the_heading_whatever_else_it_does():
    lying = pose(frames=20)
    lying.poses[:, 0] = (np.pi / 2, 0, 0)
    turned = pose(frames=20)
    turned.poses[:, 0] = (0, 2.5, 0)
    whole = in_sequence([turned, lying], 0.2)
    last = Rotation.from_rotvec(whole.poses[-1, 0].astype(float))
    expected = Rotation.from_rotvec([0, 2.5, 0]) * Rotation.from_rotvec([np.pi / 2, 0, 0])
    assert (last.inv() * expected).magnitude() < 1e-5


def test_one_frame_is_held_for_as_long_as_its_blends():
    whole = in_sequence([pose("a", 0.0), pose("b", 1.0), pose("c", -1.0)], 0.4)
    # 13, 25 and 13 frames, less 12 twice
    assert len(whole) == 13 + 25 + 13 - 24
    angle = whole.poses[:, 1, 0]
    assert angle[0] == 0
    assert angle[13] == pytest.approx(1, abs=1e-6)
    assert angle[-1] == pytest.approx(-1, abs=1e-6)
    assert (np.diff(angle[:14]) >= -1e-7).all()
    assert np.abs(np.diff(angle)).max() < 15 / 8 * 2 / 13 + 1e-6


def test_without_a_blend_the_next_follows_at_once():
    whole = in_sequence([pose("a", 0.0, 3), pose("b", 1.0, 2)], 0)
    np.testing.assert_allclose(whole.poses[:, 1, 0], [0, 0, 0, 1, 1], atol=1e-6)


def test_rates_differ_and_the_highest_is_taken():
    whole = in_sequence([pose("a", 0.0, 31, fps=30.0), pose("b", 0.0, 61, fps=60.0)], 0.5)
    assert whole.fps == 60
    assert len(whole) == 61 + 61 - 30


def test_a_half_turn_of_a_joint_and_one_beyond_are_passed():
    whole = in_sequence([pose("a", 0.0, 20), pose("b", np.pi, 20), pose("c", 3 * np.pi / 2, 20)], 0.4)
    assert np.isfinite(whole.poses).all()
    assert largest_turn(whole) < 15 / 8 * np.pi / 13 + 1e-4


def test_a_face_that_only_one_has_comes_and_goes():
    smile = pose("b", 0.0, 20, expression=np.ones((20, 4), np.float32))
    whole = in_sequence([pose("a", 0.0, 20), smile, pose("c", 0.0, 20)], 0.2)
    assert whole.expression.shape == (len(whole), 4)
    assert whole.expression[0].max() == whole.expression[-1].max() == 0
    assert whole.expression.max() == 1
    assert np.abs(np.diff(whole.expression[:, 0])).max() < 15 / 8 / 7 + 1e-6


def test_one_motion_alone_is_itself():
    walk = read_motion("walk")
    assert in_sequence([walk], 0.4) is walk


@pytest.mark.parametrize(
    ("motions", "blend", "message"),
    [
        ([], 0.4, "at least"),
        ([pose(), pose()], -1, "blend=-1"),
        ([pose(), pose()], float("nan"), "blend=nan"),
        ([pose(joints=3), pose(joints=4)], 0.4, "3 and 4 joints"),
    ],
)
def test_what_cannot_follow_is_refused(motions, blend, message):
    with pytest.raises(WrongValue, match=message):
        in_sequence(motions, blend)


def test_a_list_of_names_is_split_but_for_files_with_commas(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert motions_named("walk,wave") == ["walk", "wave"]
    assert motions_named("walk,,wave,") == ["walk", "wave"]
    assert motions_named("") == []
    (tmp_path / "a,b.npz").touch()
    (tmp_path / "x,y").mkdir()
    assert motions_named("a,b.npz") == ["a,b.npz"]
    assert motions_named("walk,a,b.npz,x,y,wave") == ["walk", "a,b.npz", "x,y", "wave"]


def test_options_go_to_the_motions_that_have_them():
    walk, wave = read_motions(["walk", "wave"], travel=True, fps=10.0, waves=2)
    assert walk.trans[-1, 2] > 1
    assert walk.fps == wave.fps == 10
    with pytest.raises(WrongValue, match="no option 'travle'"):
        read_motions(["walk", "wave"], travle=True)
