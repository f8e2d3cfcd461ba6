"""Numbers that cannot be meant: a note or an error, never silence; and the option that helps, as it is written."""

from __future__ import annotations

import numpy as np
import pytest
from motion_files import amass, assert_same_rotations, walk

from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.rotation_kinds import are_positions


def file(path, **changes):
    """An AMASS file of a walk of 24 joints, with entries changed or (None) left out."""
    truth = walk(12)
    entries = {"poses": truth["poses"].reshape(12, -1), "trans": truth["trans"], "mocap_framerate": 30.0} | changes
    np.savez(path, **{key: value for key, value in entries.items() if value is not None})
    return path


@pytest.mark.parametrize("rate", [1, 23.976, 30, 120, 500])
def test_rates_that_recordings_have_are_taken_without_a_word(tmp_path, rate):
    motion = read_motion(file(tmp_path / "a.npz", mocap_framerate=rate, trans=None), up="y")
    assert motion.fps == pytest.approx(rate)
    assert motion.notes == ()


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (501.0, r"501 frames a second which no recording has; say the rate with `fps=30`"),
        (12, r"12 frames a second"),
        (1e9, "no recording"),
        (1 / 30, r"less than one: is it the seconds of a frame, `fps=30`\?"),
        (1e-9, r"less than one; say the rate"),
        (0, r"one positive number of frames per second; say the rate with `fps=30`"),
        (-30, "positive"),
        (np.nan, "positive"),
        (np.inf, "positive"),
        ([30, 30], "one positive number"),
    ],
)
def test_other_rates_name_the_field_and_the_option(tmp_path, rate, message):
    path = file(tmp_path / "a.npz", mocap_framerate=rate)
    if rate == 12:  # as many as it has frames, but a rate all the same
        assert read_motion(path).fps == 12
        return
    with pytest.raises(UserError, match=r"a\.npz: mocap_framerate.*" + message):
        read_motion(path)
    assert read_motion(path, fps=25).fps == 25


def test_a_rate_that_is_the_number_of_frames_is_told_as_such(tmp_path):
    path = amass(tmp_path / "a.npz", poses=np.zeros((900, 66)), trans=np.zeros((900, 3)), mocap_framerate=900)
    with pytest.raises(UserError, match="900 frames a second, as many as it has frames, which no recording has"):
        read_motion(path)
    one = amass(tmp_path / "one.npz", poses=np.zeros((1, 66)), trans=np.zeros((1, 3)), mocap_framerate=1000)
    assert read_motion(one).fps == 1000  # of one frame it does not matter


def test_a_missing_rate_is_taken_as_30_with_a_note(tmp_path):
    motion = read_motion(file(tmp_path / "a.npz", mocap_framerate=None))
    assert motion.fps == 30
    assert any("no frame rate: 30 a second" in n and "`fps=25`" in n for n in motion.notes)
    assert read_motion(file(tmp_path / "a.npz", mocap_framerate=None), fps=50).notes == ()
    one = amass(tmp_path / "one.npz", poses=np.zeros((1, 66)), trans=np.zeros((1, 3)), mocap_framerate=None)
    assert read_motion(one).notes == ()


@pytest.mark.parametrize("fps", ["fast", -1, 1e6, True, None])
def test_a_senseless_option_is_refused(tmp_path, fps):
    with pytest.raises(UserError, match=f"fps={fps}"):
        read_motion(file(tmp_path / "a.npz"), fps=fps)


@pytest.mark.parametrize(("scale", "unit"), [(100, "cm"), (1000, "mm")])
def test_translations_that_would_lift_a_person_above_any_house_are_taken_for_other_units(tmp_path, scale, unit):
    truth = walk(12)
    motion = read_motion(file(tmp_path / "a.npz", trans=truth["trans"] * scale), up="y")
    np.testing.assert_allclose(motion.trans, truth["trans"], rtol=1e-5)
    note = f"trans is {0.9 * scale:.0f} high: it is taken for {unit}, not metres; `units=m`"
    assert any(note in told for told in motion.notes)
    kept = read_motion(file(tmp_path / "a.npz", trans=truth["trans"] * scale), up="y", units="m")
    np.testing.assert_allclose(kept.trans, truth["trans"] * scale, rtol=1e-5)
    assert kept.notes == ()
    said = read_motion(file(tmp_path / "a.npz", trans=truth["trans"] * scale), up="y", units=unit)
    np.testing.assert_allclose(said.trans, truth["trans"], rtol=1e-5)
    assert said.notes == ()


def test_centimetres_in_a_z_up_world_are_seen_too(tmp_path):
    poses, trans = np.zeros((5, 66)), np.tile([10.0, 20, 95], (5, 1))
    poses[:, 0] = np.pi / 2
    motion = read_motion(amass(tmp_path / "a.npz", poses=poses, trans=trans))
    np.testing.assert_allclose(motion.trans[:, 1], 0.95, rtol=1e-5)


@pytest.mark.parametrize(
    ("way", "message"),
    [
        (np.linspace(0, 3000, 300), "goes 3000 m far"),  # a run of ten seconds: no person's, in whatever unit
        (np.linspace(0, 60, 12), r"at 164 m a second"),  # centimetres of a sway, perhaps
    ],
)
def test_ways_that_are_only_odd_are_noted(tmp_path, way, message):
    trans = np.stack([way, 0 * way + 0.9, 0 * way], -1)
    poses = np.zeros((len(way), 66))
    motion = read_motion(amass(tmp_path / "a.npz", poses=poses, trans=trans, mocap_framerate=30))
    if "3000" in message:
        np.testing.assert_allclose(motion.trans[-1, 0], 30, rtol=1e-5)
        assert any("goes 3000 far: it is taken for cm" in note for note in motion.notes)
    else:
        np.testing.assert_allclose(motion.trans, trans, rtol=1e-5)
        assert any(message in note and "`units=cm`" in note for note in motion.notes)


def test_a_long_run_is_noted_and_kept_and_the_end_of_the_world_is_refused(tmp_path):
    way = np.linspace(0, 400, 2000)  # 400 m in 67 seconds
    trans, poses = np.stack([way, 0 * way + 0.9, 0 * way], -1), np.zeros((2000, 66))
    motion = read_motion(amass(tmp_path / "a.npz", poses=poses, trans=trans, mocap_framerate=30))
    np.testing.assert_allclose(motion.trans, trans, rtol=1e-5)
    assert any("goes 400 m far" in note for note in motion.notes)
    with pytest.raises(UserError, match=r"a\.npz: trans is up to 4e\+32 m away"):
        read_motion(amass(tmp_path / "a.npz", poses=poses, trans=trans * 1e30, mocap_framerate=30))


def test_degrees_are_refused_and_read_when_they_are_said_to_be_such(tmp_path):
    truth = walk(12)
    path = file(tmp_path / "a.npz", poses=np.degrees(truth["poses"]).reshape(12, -1))
    with pytest.raises(UserError, match=r"turns a joint by \d+ radians.*`rotations=degrees`"):
        read_motion(path)
    assert_same_rotations(read_motion(path, up="y", rotations="degrees"), truth["poses"])


def test_more_than_a_full_turn_is_noted_but_not_of_the_pelvis(tmp_path):
    poses = np.zeros((3, 22, 3))
    poses[:, 0, 1] = 7
    path = amass(tmp_path / "a.npz", poses=poses.reshape(3, 66), trans=np.zeros((3, 3)))
    assert read_motion(path, up="y").notes == ()
    poses[:, 5, 0] = 7
    path = amass(tmp_path / "a.npz", poses=poses.reshape(3, 66), trans=np.zeros((3, 3)))
    assert any("7.0 radians, more than a full turn" in note for note in read_motion(path, up="y").notes)
    poses[1, 5, 0] = 1e6
    with pytest.raises(UserError, match=r"by 1e\+06 radians: these are no rotations"):
        read_motion(amass(tmp_path / "a.npz", poses=poses.reshape(3, 66), trans=np.zeros((3, 3))))


@pytest.mark.parametrize(
    ("width", "message"),
    [
        (144, "24 joints in 6D"), (132, "22 joints in 6D"), (330, "55 joints in 6D"), (216, "24 matrices"),
        (69, "23 joints: a body without its pelvis"), (63, "21 joints: a body without its pelvis"),
        (96, "24 quaternions"),
    ],
)  # fmt: skip
def test_widths_that_tell_another_kind_are_named(tmp_path, width, message):
    poses = np.random.default_rng(0).normal(0, 0.3, (4, width))
    with pytest.raises(UserError, match=f"poses holds {width} numbers a frame: {message}"):
        read_motion(amass(tmp_path / "a.npz", poses=poses))


def test_a_count_of_joints_that_no_body_has_is_noted(tmp_path):
    motion = read_motion(amass(tmp_path / "a.npz", poses=np.zeros((4, 93)), trans=None))
    assert motion.poses.shape == (4, 31, 3)
    assert any("31 joints, which no body of the SMPL family has (22, 24, 52, 55)" in note for note in motion.notes)


def places_of(poses):
    """(T, 22, 3) joints of the free body."""
    from make_bundle import free_body

    from gavatar_runtime.geometry.kinematics import joint_transforms

    body = free_body()
    _, rest = body.shaped(None)
    whole = np.zeros((len(poses), len(rest), 3))
    whole[:, :22] = poses[:, :22]
    return joint_transforms(whole, rest, body.parents)[:, :22, :3, 3]


@pytest.mark.parametrize("scale", [1, 1000])
@pytest.mark.parametrize("frames", [1, 12])
def test_joint_positions_are_told_from_rotations(tmp_path, scale, frames):
    truth = walk(frames)["poses"].astype(np.float64)
    assert not are_positions(truth)
    assert not are_positions(np.random.default_rng(0).normal(0, 0.4, (frames, 24, 3)))
    assert not are_positions(np.zeros((frames, 22, 3)))
    places = places_of(truth) * scale + np.array([0.5, 0, 2]) * scale
    assert are_positions(places)
    with pytest.raises(UserError, match=r"poses holds positions of 22 joints.*`rotations=axis-angle`"):
        read_motion(amass(tmp_path / "a.npz", poses=places, trans=None))


def test_positions_of_other_joints_are_told_by_bones_that_keep_their_length():
    places = places_of(walk(30)["poses"].astype(np.float64))
    order = np.random.default_rng(0).permutation(22)[:17]
    assert are_positions(places[:, order])
    assert not are_positions(np.random.default_rng(0).normal(0, 0.4, (30, 17, 3)))
    assert not are_positions(np.zeros((30, 17, 3)))
    assert not are_positions(places[:, :5])
