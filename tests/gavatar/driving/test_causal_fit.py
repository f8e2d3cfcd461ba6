"""The causal fit on landmarks of people whose pose is known."""

from __future__ import annotations

import numpy as np
import pytest
from known_people import plausible_motion, seen_by, truth_of

from gavatar.driving.causal_fit import CALIBRATION, CausalFit, _change_of_angles
from gavatar.driving.live_skeleton import LONGEST, MEASURED, SHORTEST, LiveSkeleton
from gavatar.preparation.initial import guess_camera
from gavatar.preparation.landmarks import INDEX, MIRROR
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle

SIZE = (512, 512)
RATE = 30.0


@pytest.fixture(scope="module")
def data():
    return load_free_body()


@pytest.fixture(scope="module")
def skeleton(data):
    return LiveSkeleton.of(data)


def before_the_camera(data, frames, turn=1.0, seed=0):
    """A known person three and a half metres before the camera that the fit assumes."""
    truth = plausible_motion(data, frames, turn, seed)
    trans = truth.trans + np.array([0, 0, -3.5])
    return truth_of(data, truth.poses, trans, 0 * truth.betas)


def fitted(skeleton, marks, fit=None):
    fit = fit or CausalFit(skeleton)
    return [fit(marks.image[t], marks.visibility[t], marks.world[t], SIZE, t / RATE) for t in range(len(marks))]


def errors(found, truth):
    """(T, 22) metres, about the pelvis."""
    mine = np.stack([f.joints - f.joints[0] for f in found])
    return np.linalg.norm(mine - (truth.joints - truth.joints[:, :1]), axis=-1)


def test_known_poses_are_found(data, skeleton):
    """Without noise what is left is the pull of the prior of anatomy, and twists that no landmark shows:
    3 cm of joints; directions of limbs within 5 degrees, a pelvis, whose tilt the spine may hide, within 9."""
    truth = before_the_camera(data, 40)
    found = fitted(skeleton, seen_by(guess_camera(*SIZE), truth, 0.0, 0.0))
    assert errors(found, truth)[5:].mean() < 0.03
    root = matrix_from_axis_angle(truth.poses[:, 0])
    off = [np.linalg.norm(axis_angle_from_matrix(f.rotations[0].T @ R)) for f, R in zip(found, root, strict=True)]
    assert np.degrees(np.mean(off[5:])) < 9
    for name, child in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
        for side in ("left", "right"):
            a, b = (data.joint_names.index(f"{side}_{part}") for part in (name, child))
            mine = np.stack([f.joints[b] - f.joints[a] for f in found])
            true = truth.joints[:, b] - truth.joints[:, a]
            cosine = (mine * true).sum(-1) / np.linalg.norm(mine, axis=-1) / np.linalg.norm(true, axis=-1)
            assert np.degrees(np.arccos(np.clip(cosine, -1, 1)))[5:].mean() < 5, name
    place = np.stack([f.joints[0] for f in found])[5:] - truth.joints[5:, 0]
    assert np.abs(place[:, :2]).max() < 0.02
    assert np.abs(place[:, 2]).max() < 0.04 * 3.5


def test_noise_of_a_network(data, skeleton):
    truth = before_the_camera(data, 40, seed=1)
    found = fitted(skeleton, seen_by(guess_camera(*SIZE), truth, 2.0, 0.03))
    assert errors(found, truth)[5:].mean() < 0.04


def test_one_picture(data, skeleton):
    truth = before_the_camera(data, 1)
    assert errors(fitted(skeleton, seen_by(guess_camera(*SIZE), truth, 0.0, 0.0)), truth).mean() < 0.03


def test_nothing_later_changes_what_was(data, skeleton):
    """Causal: a fit of the first pictures alone gives the same numbers."""
    marks = seen_by(guess_camera(*SIZE), before_the_camera(data, 12))
    whole, part = fitted(skeleton, marks), fitted(skeleton, marks[:6])
    for a, b in zip(whole[:6], part, strict=True):
        assert np.array_equal(a.rotations, b.rotations)
        assert np.array_equal(a.trans, b.trans)


@pytest.mark.parametrize("depth", [False, True])
@pytest.mark.parametrize("sides", [False, True])
def test_front_and_back_confused_for_a_while(data, skeleton, depth, sides):
    """Of somebody seen from half the side: from the front alone a trunk is the same with its depth reversed."""
    truth = before_the_camera(data, 12, turn=1.5)
    marks = seen_by(guess_camera(*SIZE), truth, 0.0, 0.0)
    if depth:
        marks.world[6:9, :, 2] *= -1
    if sides:
        marks.world[6:9] = marks.world[6:9][:, MIRROR]
        marks.image[6:9] = marks.image[6:9][:, MIRROR]
    if not (depth and sides):  # both together is somebody seen from behind: the fit may believe it
        assert errors(fitted(skeleton, marks), truth)[6:9].mean() < 0.05


def test_bones_become_those_of_the_person(data, skeleton):
    """A child's short limbs are measured over the first pictures, and bounded."""
    factors = np.array([0.9, 1.05, 0.95, 0.8, 0.85, 0.9, 1.1])
    child = skeleton.scaled(factors)
    assert child.lengths(child.points) / skeleton.lengths(skeleton.points) == pytest.approx(factors, rel=0.1)
    fit = CausalFit(skeleton)
    _, _, points = child.posed(np.tile(np.eye(3), (22, 1, 1)))
    hips = points[[INDEX["left_hip"], INDEX["right_hip"]]].mean(0)
    camera = guess_camera(*SIZE)
    world = (points - hips) @ camera.T_camera_world[:3, :3].T
    image = camera.project(points[None] + [0, 0, -3.5])[0, :, :2]
    for t in range(CALIBRATION):
        assert not fit.calibrated
        fit(image, np.ones(33), world, SIZE, t / RATE)
    assert fit.calibrated
    mine = fit.skeleton.lengths(fit.skeleton.points)
    assert mine == pytest.approx(child.lengths(child.points), rel=0.05)
    for wild in (np.zeros(len(MEASURED)), np.full(len(MEASURED), 9.0)):
        grown = skeleton.scaled(wild).lengths(skeleton.scaled(wild).points) / skeleton.lengths(skeleton.points)
        assert (grown > SHORTEST - 0.1).all()
        assert (grown < LONGEST + 0.1).all()


def test_lengths_never_seen_stay_those_of_the_mean(data, skeleton):
    truth = before_the_camera(data, 5)
    marks = seen_by(guess_camera(*SIZE), truth, 0.0, 0.0)
    legs = [k for name, k in INDEX.items() if any(p in name for p in ("hip", "knee", "ankle", "heel", "foot"))]
    marks.visibility[:, legs] = 0.0
    fit = CausalFit(skeleton)
    found = fitted(skeleton, marks, fit)
    assert all(np.isfinite(f.rotations).all() and np.isfinite(f.trans).all() for f in found)
    thigh = MEASURED.index("thigh")
    assert fit.skeleton.lengths(fit.skeleton.points)[thigh] == pytest.approx(skeleton.lengths(skeleton.points)[thigh])


@pytest.mark.parametrize("time", [0.0, -1.0, np.nan, np.inf])
def test_times_that_do_not_go_on(data, skeleton, time):
    marks = seen_by(guess_camera(*SIZE), before_the_camera(data, 3))
    fit = CausalFit(skeleton)
    for t in range(3):
        found = fit(marks.image[t], marks.visibility[t], marks.world[t], SIZE, time)
    assert np.isfinite(found.rotations).all()


def test_all_points_in_one_place_or_unseen(skeleton):
    """Nonsense of a network gives a pose of a body, not NaN."""
    for visibility in (0.0, 1.0):
        fit = CausalFit(skeleton)
        for t in range(3):
            found = fit(np.full((33, 2), 200.0), np.full(33, visibility), np.zeros((33, 3)), SIZE, t / RATE)
            assert np.isfinite(found.rotations).all()
            assert np.isfinite(found.trans).all()
            assert np.abs(found.rotations @ np.swapaxes(found.rotations, -1, -2) - np.eye(3)).max() < 1e-6


@pytest.mark.parametrize("angle", [0.0, 1e-5, 0.3, 2.0, 3.0])
def test_change_of_angles_is_that_of_differences(angle):
    """Against finite differences; 1e-5 of a step squared over it."""
    start = angle * np.array([0.6, -0.48, 0.64])
    step = 1e-5
    columns = []
    for axis in np.eye(3):
        sides = [
            axis_angle_from_matrix(matrix_from_axis_angle(start) @ matrix_from_axis_angle(s * axis))
            for s in (step, -step)
        ]
        columns.append((sides[0] - sides[1]) / (2 * step))
    assert _change_of_angles(start[None])[0] == pytest.approx(np.stack(columns, -1), abs=1e-5)
