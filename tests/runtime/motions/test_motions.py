"""Motion sources: AMASS files, built-in motions, and how a name or file finds its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make_bundle import free_body

from gavatar_runtime import plugins
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.motions import MOTIONS, read_motion
from gavatar_runtime.motions.fitting import fit_motion
from gavatar_runtime.values.body import SMPL_BODY_JOINTS, Hands
from gavatar_runtime.values.motion import HandParameters, Motion
from gavatar_runtime.values.skeletons import BODY, SMPL, SMPLH, SMPLX


def amass(path, **changes):
    """An AMASS file of 4 frames and 52 joints, with entries changed, added or (None) left out."""
    rng = np.random.default_rng(0)
    entries = {
        "poses": rng.normal(0, 0.3, (4, 156)),
        "trans": rng.normal(0, 1, (4, 3)),
        "betas": np.zeros(16),
        "mocap_framerate": np.float64(60),
        "gender": np.array("male"),
    } | changes
    np.savez(path, **{k: v for k, v in entries.items() if v is not None})
    return path


# AMASS files


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


def nan_from(frame, shape):
    values = np.zeros(shape)
    values[frame:] = np.nan
    return values


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
        ({"mocap_framerate": None}, "'mocap_framerate' is missing"),
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
    with pytest.raises(UserError, match=r"a\.npz is empty, damaged or not an \.npz"):
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


# the vertical axis


def z_up(poses, trans):
    """The same motion in a z-up world, as AMASS stores it: x stays, y becomes z."""
    C = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    from gavatar_runtime.geometry.rotations import axis_angle_from_matrix

    poses = poses.copy().reshape(len(poses), -1, 3)
    poses[:, 0] = axis_angle_from_matrix(C @ matrix_from_axis_angle(poses[:, 0]))
    return poses.reshape(len(poses), -1), trans @ C.T


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


def test_an_unknown_vertical_axis_or_option_lists_the_choices(tmp_path):
    file = amass(tmp_path / "a.npz")
    with pytest.raises(UserError, match="auto, y, z"):
        read_motion(file, up="x")
    with pytest.raises(UserError, match=r"no option 'ups'.*did you mean 'up'"):
        read_motion(file, ups="z")
    with pytest.raises(UserError, match="fps"):
        read_motion(file, fps="fast")


# built-in motions


def joints_of(motion: Motion) -> np.ndarray:
    """(T, 52, 3) joint places on the free body, metres."""
    body = free_body()
    _, joints = body.shaped(None)
    T = joint_transforms(motion.poses.astype(np.float64), joints, body.parents)
    return T[..., :3, 3] + motion.trans[:, None]


@pytest.mark.parametrize("name", ["turn", "wave"])
def test_a_built_in_motion_fits_the_body_and_loops(name):
    motion = read_motion(name)
    assert motion.poses.shape[1:] == (len(SMPLH), 3)
    assert np.isfinite(motion.poses).all()
    assert np.isfinite(motion.trans).all()
    joints = joints_of(motion)
    steps = np.linalg.norm(np.diff(np.concatenate([joints, joints[:1]]), axis=0), axis=-1).max(1)
    # from the last frame back to the first no joint moves further than within the loop
    assert steps[-1] <= steps[:-1].max() * (1 + 1e-4)


def test_the_turn_passes_every_side_once():
    motion = read_motion("turn", seconds=2, fps=8)
    forward = matrix_from_axis_angle(motion.poses[:, 0].astype(np.float64))[..., 2]
    heading = np.unwrap(np.arctan2(forward[:, 0], forward[:, 2]))
    np.testing.assert_allclose(heading, 2 * np.pi * np.arange(16) / 16, atol=1e-6)  # float32 angles


def test_in_the_turn_the_arms_hang_beside_the_hips():
    joints = joints_of(read_motion("turn"))[0]
    for side, sign in (("left", 1), ("right", -1)):
        shoulder, wrist, hip = (joints[SMPLH.index(f"{side}_{n}")] for n in ("shoulder", "wrist", "hip"))
        down = (shoulder - wrist) / np.linalg.norm(shoulder - wrist)
        assert np.degrees(np.arccos(down[1])) < 35  # from the vertical
        assert sign * (wrist[0] - hip[0]) > 0.1  # metres: clear of the thigh


def test_in_the_wave_the_right_hand_is_up_and_swings_and_nothing_else_does():
    joints = joints_of(read_motion("wave"))
    names = ("right_wrist", "right_shoulder", "left_wrist", "left_ankle")
    place = {n: joints[:, SMPLH.index(n)] for n in names}
    assert (place["right_wrist"][:, 1] > place["right_shoulder"][:, 1] + 0.1).all()
    assert np.ptp(place["right_wrist"][:, 0]) > 0.1
    assert np.ptp(place["left_wrist"], axis=0).max() < 0.08  # sways with the body
    assert np.ptp(place["left_ankle"], axis=0).max() < 0.01  # feet stay on the floor


def test_the_wave_swings_as_often_as_asked():
    wrist = joints_of(read_motion("wave", waves=3))[:, SMPLH.index("right_wrist"), 0]
    spectrum = np.abs(np.fft.rfft(wrist - wrist.mean()))
    assert np.argmax(spectrum) == 3


def test_the_relaxed_pose_is_mirrored():
    joints = joints_of(read_motion("turn"))[0]
    left = [SMPLH.index(n) for n in SMPLH if n.startswith("left")]
    right = [SMPLH.index(SMPLH[j].replace("left", "right")) for j in left]
    # 8 mm: the free body's own rest joints are symmetric within 3 mm, at the end of a chain of eight
    np.testing.assert_allclose(joints[left] * (-1, 1, 1), joints[right], atol=8e-3)


def test_a_short_built_in_motion_is_one_frame():
    assert len(read_motion("turn", seconds=1e-3)) == 1
    assert len(read_motion("wave", seconds=1e-3, waves=0)) == 1


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("turn", {"seconds": 0}, "seconds=0 must be a positive number"),
        ("turn", {"fps": float("nan")}, "fps=nan"),
        ("turn", {"seconds": "long"}, "seconds=long"),
        ("turn", {"seconds": 1e9}, "more than"),
        ("wave", {"waves": 1.5}, "waves=1.5"),
        ("wave", {"wave": 3}, "no option 'wave'.*did you mean 'waves'"),
    ],
)
def test_wrong_options_of_a_built_in_motion_are_named(name, options, message):
    with pytest.raises(UserError, match=message):
        read_motion(name, **options)


# names and files


def test_an_unknown_name_lists_names_and_suffixes_and_the_nearest():
    with pytest.raises(UserError, match=r"unknown motion 'wavee'.*\.npz.*turn, wave.*did you mean 'wave'"):
        read_motion("wavee")


def test_a_file_of_an_unknown_suffix_and_a_format_name_are_unknown_motions():
    for source in ("dance.fbx", "amass", "", "."):
        with pytest.raises(UserError, match="unknown motion"):
            read_motion(source)


def test_a_missing_file_and_a_folder_are_told_apart(tmp_path):
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(UserError, match=r"absent\.npz does not exist"):
        read_motion(tmp_path / "absent.npz")
    with pytest.raises(UserError, match=r"folder\.npz is a directory"):
        read_motion(tmp_path / "folder.npz")


def test_the_suffix_may_be_in_capitals(tmp_path):
    amass(tmp_path / "a.npz").rename(tmp_path / "A.NPZ")
    assert len(read_motion(tmp_path / "A.NPZ")) == 4


def test_a_new_format_is_one_decorated_class(tmp_path):
    @MOTIONS.register("still")
    class Still:
        suffixes = (".still",)

        def __init__(self, config, *, path):
            self.path = path

        def load(self):
            return Motion(np.zeros((1, 22, 3), np.float32), np.zeros((1, 3), np.float32), 1.0)

    try:
        (tmp_path / "a.still").write_text("")
        assert len(read_motion(tmp_path / "a.still")) == 1
    finally:
        del MOTIONS._components["still"]


def test_plugins_are_asked_for_an_unknown_name_only_and_a_broken_one_is_named(monkeypatch):
    import importlib.metadata

    class Point:
        def __init__(self, name, load):
            self.name, self.load = name, load

    def broken():
        raise ImportError("no module 'sensor'")

    def nod():
        @MOTIONS.register("nod")
        class Nod:
            suffixes = ()

            def __init__(self, config):
                pass

            def load(self):
                return Motion(np.zeros((2, 22, 3), np.float32), np.zeros((2, 3), np.float32), 1.0, name="nod")

    asked = []

    def entry_points(group):
        asked.append(group)
        return [Point("bad", broken), Point("good", nod)]

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
    plugins.load_entry_points.cache_clear()
    try:
        read_motion("wave")
        assert asked == []
        with pytest.warns(UserWarning, match="plugin bad was skipped: ImportError: no module 'sensor'"):
            assert read_motion("nod").name == "nod"
        assert asked == ["gavatar.plugins"]
    finally:
        plugins.load_entry_points.cache_clear()
        MOTIONS._components.pop("nod", None)


# joints of another skeleton


def named_motion(names, frames=2):
    """A motion whose joint j turns by j + 1 hundredths about x."""
    poses = np.zeros((frames, len(names), 3), np.float32)
    poses[:, :, 0] = 0.01 * (1 + np.arange(len(names)))
    return Motion(poses, np.zeros((frames, 3), np.float32), 30.0)


@pytest.mark.parametrize("source", [BODY, SMPL, SMPLH, SMPLX], ids=["body", "smpl", "smplh", "smplx"])
@pytest.mark.parametrize("target", [BODY, SMPL, SMPLH, SMPLX], ids=["body", "smpl", "smplh", "smplx"])
def test_between_skeletons_every_rotation_goes_to_the_joint_of_its_name(source, target):
    motion = named_motion(source)
    fitted, ignored = fit_motion(motion, target)
    assert set(ignored) == set(source) - set(target)
    for j, name in enumerate(target):
        expected = motion.poses[:, source.index(name)] if name in source else np.zeros((2, 3))
        np.testing.assert_array_equal(fitted.poses[:, j], expected, err_msg=name)


def test_joints_that_do_not_move_are_not_reported_as_ignored():
    motion = named_motion(SMPLH)
    motion.poses[:, SMPL_BODY_JOINTS:] = 0
    assert fit_motion(motion, SMPL)[1] == ()


def test_a_skeleton_of_unknown_size_keeps_the_order_of_its_joints():
    motion = named_motion([f"j{i}" for i in range(30)])
    fitted, ignored = fit_motion(motion, SMPL)
    np.testing.assert_array_equal(fitted.poses, motion.poses[:, :24])
    assert ignored == tuple(f"joint {j}" for j in range(24, 30))
    fitted, ignored = fit_motion(dataclasses.replace(motion, poses=motion.poses[:, :5]), SMPL)
    assert fitted.poses.shape == (2, 24, 3)
    assert ignored == ()
    assert not fitted.poses[:, 5:].any()


def hands_of(count=12):
    rng = np.random.default_rng(3)
    return Hands(rng.normal(0, 0.3, (2, 15, 3)), rng.normal(0, 0.3, (2, count, 45)))


@pytest.mark.parametrize("pca", [True, False])
@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("names", [SMPLH, SMPLX], ids=["smplh", "smplx"])
def test_hand_parameters_become_finger_rotations_by_the_bodys_hand_data(names, pca, relative):
    hands, motion = hands_of(), named_motion(BODY)
    values = np.random.default_rng(0).normal(0, 0.5, (2, 2, 6 if pca else 45)).astype(np.float32)
    motion = dataclasses.replace(motion, hands=HandParameters(values, pca, relative))
    fitted, ignored = fit_motion(motion, names, np.full((len(names), 3), 0.7), hands=hands)
    assert ignored == ()
    assert fitted.hands is None
    for side, finger in ((0, "left_index1"), (1, "right_index1")):
        rotations = values[:, side] @ hands.components[side][:6] if pca else values[:, side]
        expected = rotations + (hands.mean[side].reshape(45) if relative else 0)
        at = names.index(finger)
        np.testing.assert_allclose(fitted.poses[:, at : at + 15].reshape(2, 45), expected, atol=1e-6)  # float32
    if names is SMPLX:
        np.testing.assert_allclose(fitted.poses[:, names.index("jaw")], 0.7, atol=1e-6)


@pytest.mark.parametrize("hands", [None, hands_of(0), hands_of(5)], ids=["none", "empty", "too few"])
def test_hand_parameters_that_the_body_has_no_data_for_are_named_and_left_at_rest(hands):
    motion = named_motion(BODY)
    motion = dataclasses.replace(motion, hands=HandParameters(np.ones((2, 2, 6), np.float32)))
    fitted, ignored = fit_motion(motion, SMPLH, np.full((52, 3), 0.2), hands=hands)
    assert ignored == ("hand components",)
    np.testing.assert_allclose(fitted.poses[:, 22:], 0.2)
    assert fit_motion(motion, SMPL, hands=hands_of())[1] == ("hand components",)  # data, but no fingers
    still = dataclasses.replace(motion, hands=HandParameters(np.zeros((2, 2, 6), np.float32)))
    assert fit_motion(still, SMPLH)[1] == ()


def test_expressions_are_cut_to_what_the_body_has_and_named_where_it_has_none():
    motion = dataclasses.replace(named_motion(BODY), expression=np.ones((2, 50), np.float32))
    assert fit_motion(motion, SMPLX, num_expression=10)[0].expression.shape == (2, 10)
    assert fit_motion(motion, SMPLX, num_expression=60)[0].expression.shape == (2, 50)
    fitted, ignored = fit_motion(motion, SMPLX)
    assert ignored == ("expressions",)
    assert fitted.expression is None
    assert fit_motion(dataclasses.replace(motion, expression=0 * motion.expression), SMPLX)[1] == ()


def test_a_motion_for_a_body_of_foreign_joint_names_keeps_its_order():
    motion = named_motion(SMPL)
    fitted, _ = fit_motion(motion, tuple(f"bone{i}" for i in range(24)))
    np.testing.assert_array_equal(fitted.poses, motion.poses)
