"""Motions that need no file."""

from __future__ import annotations

import numpy as np
import pytest
from make_bundle import free_body

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.skeletons import SMPLH


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
