"""The built-in motions that are drawn on a figure: idle, walk, run, jump, dance, stretch."""

from __future__ import annotations

import numpy as np
import pytest
from make_bundle import free_body

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.builtin.curves import cyclic, eased, through
from gavatar_runtime.motions.builtin.figure import LEG_LENGTH, PITCHES, clearing, rolled
from gavatar_runtime.motions.fitting import scaled_to_legs
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.skeletons import SMPLH

NAMES = ["idle", "walk", "run", "jump", "dance", "stretch"]


def joints_of(motion: Motion, offset: float = 0.0) -> np.ndarray:
    """(T, 52, 3) joint places on the free body, metres."""
    body = free_body()
    _, joints = body.shaped(None)
    motion = scaled_to_legs(motion, body.joint_names, joints)
    T = joint_transforms(motion.poses.astype(np.float64), joints, body.parents)
    return T[..., :3, 3] + motion.trans[:, None]


def of(joints: np.ndarray, name: str) -> np.ndarray:
    return joints[:, SMPLH.index(name)]


@pytest.mark.parametrize("name", NAMES)
def test_a_motion_is_finite_and_loops(name):
    motion = read_motion(name, fps=60)
    assert motion.poses.shape[1:] == (len(SMPLH), 3)
    assert np.isfinite(motion.poses).all()
    assert np.isfinite(motion.trans).all()
    joints = joints_of(motion)
    steps = np.linalg.norm(np.diff(np.concatenate([joints, joints[:1]]), axis=0), axis=-1).max(1)
    # from the last frame back to the first no joint moves further than within the loop
    assert steps[-1] <= steps[:-1].max() * (1 + 1e-4)


@pytest.mark.parametrize(
    ("name", "options", "way"),
    [("walk", {}, 1.35), ("walk", {"speed": 0.8}, 0.8), ("run", {}, 2.8), ("jump", {"forward": 0.5}, 0.5 / 2.6)],
)
def test_what_travels_goes_as_far_as_it_says_and_repeats_from_there(name, options, way):
    ahead = read_motion(name, fps=50, **(options if name == "jump" else {**options, "travel": True}))
    place = read_motion(name, fps=50, **({} if name == "jump" else options))
    seconds = len(ahead) / 50
    np.testing.assert_allclose(ahead.trans[0], place.trans[0], atol=1e-6)
    # by the last frame, all but one frame of the way (a jump has long landed)
    gone = ahead.trans[-1, 2] - place.trans[-1, 2]
    assert gone == pytest.approx(way * (seconds if name == "jump" else seconds - 1 / 50), abs=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_twice_as_many_frames_are_the_same_motion(name):
    options = {"bpm": 120.0} if name == "dance" else {"seconds": 3.0}
    slow, fast = (read_motion(name, fps=fps, **options) for fps in (20, 40))
    even = fast.taken(slice(None, None, 2))
    assert len(even) == len(slow)
    # 3 mm, a hundredth of a radian: how far a walking body is lowered is looked for at the frames
    np.testing.assert_allclose(even.trans, slow.trans, atol=3e-3)
    np.testing.assert_allclose(even.poses, slow.poses, atol=0.05)


def test_arms_swing_against_legs_and_the_chest_against_the_pelvis():
    joints = joints_of(read_motion("walk", fps=60))
    for side, other in (("left", "right"), ("right", "left")):
        leg = of(joints, f"{side}_ankle")[:, 2] - of(joints, "pelvis")[:, 2]
        same, opposite = (of(joints, f"{s}_wrist")[:, 2] - of(joints, f"{s}_shoulder")[:, 2] for s in (side, other))
        assert np.corrcoef(leg, same)[0, 1] < -0.8
        assert np.corrcoef(leg, opposite)[0, 1] > 0.8
    hips, shoulders = (of(joints, f"left_{n}")[:, 2] - of(joints, f"right_{n}")[:, 2] for n in ("hip", "shoulder"))
    assert np.corrcoef(hips, shoulders)[0, 1] < -0.8


def test_the_weight_is_over_the_leg_that_stands():
    joints = joints_of(read_motion("walk", fps=60))
    lifted = of(joints, "left_ankle")[:, 1] - of(joints, "right_ankle")[:, 1]
    assert np.corrcoef(of(joints, "pelvis")[:, 0], lifted)[0, 1] < -0.6  # left foot up: to the right, -x


def test_a_walk_has_a_foot_down_and_a_run_has_none_at_times():
    for name, flies in (("walk", False), ("run", True)):
        joints = joints_of(read_motion(name, fps=120))
        rest = joints_of(Motion(np.zeros((1, 52, 3), np.float32), np.zeros((1, 3), np.float32), 30.0))
        toes = [of(joints, f"{s}_foot")[:, 1] - of(rest, f"{s}_foot")[0, 1] for s in ("left", "right")]
        heels = [of(joints, f"{s}_ankle")[:, 1] - of(rest, f"{s}_ankle")[0, 1] for s in ("left", "right")]
        # 1.5 cm: the toes' joint and the ankle rise by less where a sole rolls on the floor
        both_up = np.min([np.minimum(t, h) for t, h in zip(toes, heels, strict=True)], 0) > 0.015
        assert both_up.any() == flies


def test_a_jump_flies_its_parabola():
    motion = read_motion("jump", fps=100, height=0.4)
    y = motion.trans[:, 1].astype(np.float64)
    highest = int(y.argmax())
    acceleration = np.diff(y[highest - 15 : highest + 16], 2) * 100**2
    np.testing.assert_allclose(acceleration, -9.81, atol=0.02)  # of float32 metres twice differenced at 100 a second
    lower = read_motion("jump", fps=100, height=0.2).trans[:, 1].max()
    assert y.max() - lower == pytest.approx(0.2, abs=2e-3)


def test_a_dance_keeps_to_its_beat():
    motion = read_motion("dance", bpm=120, bars=4, fps=40)
    assert len(motion) == 4 * 4 * 20
    height = motion.trans[:, 1] - motion.trans[:, 1].mean()
    assert np.argmax(np.abs(np.fft.rfft(height))) == 16  # once a beat
    np.testing.assert_allclose(motion.poses[:160], motion.poses[160:], atol=1e-5)  # two bars, twice


def test_a_stretch_goes_overhead_aside_and_down():
    joints = joints_of(read_motion("stretch", fps=20))
    wrists = np.minimum(of(joints, "left_wrist")[:, 1], of(joints, "right_wrist")[:, 1])
    assert (wrists > of(joints, "head")[:, 1] + 0.2).any()
    assert (
        np.maximum(of(joints, "left_wrist")[:, 1], of(joints, "right_wrist")[:, 1]) < of(joints, "left_knee")[:, 1]
    ).any()
    aside = of(joints, "head")[:, 0] - of(joints, "pelvis")[:, 0]
    assert aside.max() > 0.15
    assert aside.min() < -0.15
    still = joints_of(read_motion("stretch", fps=20, reach=0.0))
    assert np.ptp(still, axis=0).max() < 1e-5


def test_an_idle_person_breathes_as_often_as_asked():
    motion = read_motion("idle", breaths=3, shift=0.0)
    collar = motion.poses[:, SMPLH.index("left_collar"), 2]
    assert np.argmax(np.abs(np.fft.rfft(collar - collar.mean()))) == 3
    assert np.ptp(read_motion("idle", shift=1.0).trans[:, 0]) > 0.04
    assert np.ptp(motion.trans[:, 0]) < 1e-6


def test_the_legs_are_those_that_the_motion_says():
    assert read_motion("walk").leg_length == LEG_LENGTH
    body = free_body()
    hip, knee, ankle = (body.shaped(None)[1][body.joint_names.index(f"left_{n}")] for n in ("hip", "knee", "ankle"))
    # the figure is the free body made symmetric: its sides differ by 3 mm
    assert pytest.approx(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle), abs=3e-3) == LEG_LENGTH


@pytest.mark.parametrize("name", NAMES)
def test_one_frame_is_a_motion(name):
    options = {"bpm": 160.0, "fps": 0.2} if name == "dance" else {"seconds": 1e-3}
    motion = read_motion(name, **options)
    assert len(motion) == 1
    assert np.isfinite(motion.poses).all()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("walk", {"speed": 9}, "speed=9.*0.3 to 2.2"),
        ("walk", {"speed": float("nan")}, "speed=nan"),
        ("walk", {"travel": "yes"}, "travel"),
        ("run", {"speed": 0.5}, "motion 'run' is made for 1.5 to 5.5"),
        ("run", {"seconds": -1}, "seconds=-1 must be a positive number"),
        ("jump", {"height": 3}, "height=3"),
        ("jump", {"seconds": 0.6}, "takes .* s at least"),
        ("dance", {"bars": 3}, "even number"),
        ("dance", {"bpm": 0}, "bpm=0"),
        ("dance", {"fps": 0}, "fps=0"),
        ("stretch", {"reach": 2}, "reach=2"),
        ("idle", {"breaths": 0.5}, "breaths=0.5"),
        ("idle", {"shift": -1}, "shift=-1"),
    ],
)
def test_wrong_options_are_named(name, options, message):
    with pytest.raises(UserError, match=message):
        read_motion(name, **options)


def test_a_cyclic_curve_passes_its_keys_and_never_leaves_them():
    keys = ((0.1, 1.0), (0.2, 1.0), (0.5, -3.0), (0.9, 2.0))
    np.testing.assert_allclose(cyclic(np.array([k for k, _ in keys]), keys), [v for _, v in keys], atol=1e-12)
    phase = np.linspace(-1, 2, 3001)
    curve = cyclic(phase, keys)
    assert curve.min() >= -3 - 1e-12
    assert curve.max() <= 2 + 1e-12
    np.testing.assert_allclose(cyclic(phase + 1, keys), curve, atol=1e-9)
    slope = np.diff(curve) / np.diff(phase)
    assert np.abs(np.diff(slope)).max() < 1.0  # no kink: a kink would be a jump of tens
    assert (cyclic(np.array([0.0, 0.7]), ((0.3, 5.0),)) == 5).all()


def test_eased_and_through_meet_their_ends():
    np.testing.assert_allclose(eased(np.array([-1, 0, 0.5, 1, 2])), [0, 0, 0.5, 1, 1])
    knots = ((0.0, 1.0, 2.0), (0.5, 3.0, -1.0), (2.0, 0.0, 0.0))
    np.testing.assert_allclose(through(np.array([-1, 0, 0.5, 2, 3]), knots), [1, 1, 3, 0, 0], atol=1e-12)
    t = np.array([0.5 - 1e-6, 0.5 + 1e-6])
    assert np.diff(through(t, knots))[0] / 2e-6 == pytest.approx(-1, abs=1e-4)


def test_a_sole_rolls_over_its_outline():
    """As high as its lowest point says, and ahead over its toes."""
    up, ahead = rolled(PITCHES).T
    assert rolled(np.array(0.0)) == pytest.approx((0, 0), abs=1e-9)
    np.testing.assert_allclose(up, clearing(PITCHES, -np.maximum(PITCHES, 0)) - clearing(0.0, 0.0), atol=1e-9)
    lifted = PITCHES > 5
    assert (np.diff(ahead[lifted]) > 0).all()  # over the toes the ankle goes ahead
    assert (up[lifted] > 0).all()
