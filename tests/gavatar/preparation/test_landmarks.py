"""Landmarks: front and back, left and right, their places on the body, their files, the lens they are seen through."""

import cv2
import numpy as np
import pytest
from known_people import FPS, cameras_around, plausible_motion, seen_by

from gavatar.preparation.anatomy import joint_ranges
from gavatar.preparation.footage.lens import Lens
from gavatar.preparation.initial import torso_frames, unflip
from gavatar.preparation.landmarks import BONES, INDEX, MIRROR, NAMES, landmark_rows, read_landmarks
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.camera import Camera

pytestmark = pytest.mark.usefixtures("one_thread")


# ---------------------------------------------------------------- front and back, left and right


def test_flipped_frames_are_read_the_right_way_round(data):
    truth, (camera,) = plausible_motion(data, frames=24), cameras_around(1)
    world = seen_by(camera, truth, depth_noise=0).world
    broken = world.copy()
    broken[10:13] = world[10:13][:, MIRROR]  # left and right exchanged
    broken[5:7] = world[5:7] * [1, 1, -1]  # depth reversed
    flipped, swapped = unflip(broken, np.ones(24, bool), 24.0)
    assert swapped[10:13].all()
    fixed = np.where(swapped[:, None, None], broken[:, MIRROR], broken) * np.where(
        flipped[:, None, None], [1, 1, -1], 1
    )
    true, found = torso_frames(world), torso_frames(fixed)
    off = np.arccos(np.clip((np.einsum("tab,tab->t", true, found) - 1) / 2, -1, 1))
    assert off[10:13].max() < 1e-3
    assert off.max() < np.pi / 2  # near a frontal or a side view the two readings of a frame nearly coincide


def test_steady_full_turn_is_left_alone(data):
    truth, (camera,) = plausible_motion(data, frames=24), cameras_around(1)
    flipped, swapped = unflip(seen_by(camera, truth).world, np.ones(24, bool), 24.0)
    assert not flipped.any()
    assert not swapped.any()


# ---------------------------------------------------------------- landmarks on the body


def test_landmarks_sit_where_their_names_say(data):
    regressor, weights = landmark_rows(data)
    points = regressor @ data.v_template
    # regressor and weights are stored as float32
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-5)
    np.testing.assert_allclose(regressor.sum(1), 1, atol=1e-5)
    for k, name in enumerate(NAMES):
        if "left" in name:
            assert points[k, 0] > 0, name
        np.testing.assert_allclose(points[MIRROR[k]] * [-1, 1, 1], points[k], atol=0.01)  # the body's own asymmetry
    heights = [points[INDEX[n], 1] for n in ("left_eye", "mouth_left", "left_shoulder", "left_hip", "left_knee")]
    assert heights == sorted(heights, reverse=True)
    assert points[INDEX["nose"], 2] > points[INDEX["left_eye"], 2] > points[INDEX["left_ear"], 2]
    assert points[INDEX["left_foot_index"], 2] - points[INDEX["left_heel"], 2] > 0.2
    assert all(a != b for a, b in BONES)


def test_joint_limits_mirror_and_contain_the_mean(data):
    low, high, mean, _ = joint_ranges(tuple(data.joint_names))
    names = list(data.joint_names)
    assert (low <= mean).all()
    assert (mean <= high).all()
    left, right = names.index("left_elbow"), names.index("right_elbow")
    np.testing.assert_allclose(high[right], [high[left, 0], -low[left, 1], -low[left, 2]])


# ---------------------------------------------------------------- reading landmarks


def write_landmarks(path, image, world=None, **more):
    np.savez(path, image=image, world=image if world is None else world, **{"fps": FPS, **more})


def points33(frames=4):
    values = np.random.default_rng(0).uniform(10, 50, (frames, 33, 4)).astype(np.float32)
    values[..., 3] = 0.9
    return values


def test_unseen_points_may_be_nan_but_seen_ones_may_not(tmp_path):
    points = points33()
    points[1, 5, :3] = np.nan
    write_landmarks(tmp_path / "a.npz", points)
    with pytest.raises(UserError, match="NaN in frame 1, point 5"):
        read_landmarks(tmp_path / "a.npz")
    points[1, 5, 3] = 0
    write_landmarks(tmp_path / "a.npz", points)
    marks = read_landmarks(tmp_path / "a.npz")
    assert np.isfinite(marks.image).all()
    assert marks.visibility[1, 5] == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p[:, :17], "shape"),
        (lambda p: p[:0], "at least 1"),
        (lambda p: p / 1000, "normalised"),
        (lambda p: np.where(np.arange(4) == 3, np.nan, p), "NaN visibility"),
    ],
)
def test_malformed_landmarks_are_refused(tmp_path, change, message):
    write_landmarks(tmp_path / "a.npz", change(points33()))
    with pytest.raises(UserError, match=message):
        read_landmarks(tmp_path / "a.npz")


def test_files_that_are_no_landmarks_are_refused(tmp_path):
    with pytest.raises(UserError, match="missing"):
        read_landmarks(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("no")
    with pytest.raises(UserError, match="cannot be read"):
        read_landmarks(tmp_path / "text.npz")
    np.savez(tmp_path / "part.npz", image=points33())
    with pytest.raises(UserError, match="'world'"):
        read_landmarks(tmp_path / "part.npz")


# ---------------------------------------------------------------- the lens


def test_undistorted_points_and_images_agree():
    camera = Camera(200, 160, 180.0, 175.0, 104.0, 77.0, np.eye(4))
    lens = Lens(camera, np.array([-0.2, 0.05, 0.002, -0.001]))
    image = np.zeros((160, 200), np.uint8)
    places = np.array([[30.5, 40.5], [150.5, 120.5], [104.5, 77.5]])
    for x, y in places:
        cv2.circle(image, (int(x), int(y)), 3, 255, -1)
    straight = lens.undistort_image(image).astype(float)
    for want in lens.undistort_points(places):
        ys, xs = np.mgrid[:160, :200]
        near = straight * (np.hypot(xs + 0.5 - want[0], ys + 0.5 - want[1]) < 8)
        centre = np.array([(near * (xs + 0.5)).sum(), (near * (ys + 0.5)).sum()]) / near.sum()
        np.testing.assert_allclose(centre, want, atol=0.3)  # a disc's centroid after bilinear resampling
