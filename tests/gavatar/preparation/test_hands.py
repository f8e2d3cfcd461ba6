"""Hands: found in a picture, read from files, and fitted to."""

from __future__ import annotations

import numpy as np
import pytest
from demo_pictures import picture
from places import DEMO

from gavatar.capture.capture import read_capture
from gavatar.preparation.hands.anatomy import hand_anatomy, has_fingers
from gavatar.preparation.hands.fit import fit_hands
from gavatar.preparation.hands.hand_files import read_hands
from gavatar.preparation.hands.hand_network import SHIFT, HandNetworks, guided, upright
from gavatar.preparation.hands.landmarks import FINGERS, PLACE, SIDES, HandLandmarks, pixels_per_metre
from gavatar.preparation.hands.track import HandTracker
from gavatar.preparation.pose_network import PoseNetworks
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.values.camera import Camera, look_at

CAMERA = Camera(640, 640, 1300.0, 1300.0, 320.0, 320.0, look_at((0, 1.0, 3.0), (0, 0.9, 0)))


def seen_hands(data, camera: Camera, poses: np.ndarray, trans: np.ndarray, noise: float = 0.0) -> HandLandmarks:
    """The landmarks of both hands as a perfect network would see them."""
    anatomy = hand_anatomy(data, None)
    seen = HandLandmarks.unseen(len(poses))
    local = matrix_from_axis_angle(poses)
    for t in range(len(poses)):
        turned: list[np.ndarray] = []
        for j, parent in enumerate(data.parents):
            turned.append(local[t, j] if parent < 0 else turned[parent] @ local[t, j])
        joints = data.posed(poses[t], None, trans[t])[1]
        for h in range(2):
            points = np.zeros((21, 3))
            points[0] = joints[anatomy.joints[h, 0]]
            for f in range(5):
                chain = anatomy.joints[h, 1 + 3 * f : 4 + 3 * f]
                points[4 * f + 1 : 4 * f + 4] = joints[chain]
                points[4 * f + 4] = joints[chain[2]] + turned[chain[2]] @ anatomy.tips[h, f]
            projected = camera.project(points)
            seen.image[t, h] = projected[:, :2]
            seen.world[t, h] = (points - points[0]) @ camera.T_camera_world[:3, :3].T
    rng = np.random.default_rng(0)
    seen.image[:] += rng.normal(size=seen.image.shape) * noise
    seen.weight[:], seen.size[:] = 1.0, 78.0
    return seen


def fists(data, frames: int) -> np.ndarray:
    """(T, J, 3) arms down and forward, hands that close from flat to a fist."""
    anatomy, poses = hand_anatomy(data, None), np.zeros((frames, data.num_joints, 3))
    names = list(data.joint_names)
    for h, side in enumerate(SIDES):
        poses[:, names.index(f"{side}_shoulder")] = [0, 0, -1.0 if side == "left" else 1.0]
        poses[:, names.index(f"{side}_elbow")] = [0, -0.8 if side == "left" else 0.8, 0]
        bend = np.linspace(0, 1.2, frames)[:, None] * np.where(np.arange(15) >= 3, 1.0, 0.3)
        poses[:, anatomy.joints[h, 1:]] = bend[..., None] * anatomy.axes[h][None, :, :, 1]
    return poses


def finger_error(data, found: np.ndarray, truth: np.ndarray) -> float:
    """Metres, mean over frames and finger joints, around the wrist."""
    joints = hand_anatomy(data, None).joints
    places = []
    for poses in (found, truth):
        posed = np.stack([data.posed(pose, None, None)[1] for pose in poses])[:, joints]
        places.append(posed - posed[:, :, :1])
    return float(np.linalg.norm(places[0] - places[1], axis=-1)[..., 1:].mean())


def test_relaxed_fingers_bend_towards_the_palm_on_both_sides(data):
    assert has_fingers(data)
    anatomy, poses = hand_anatomy(data, None), np.zeros((data.num_joints, 3))
    for h in range(2):
        poses[anatomy.joints[h, 1:]] = anatomy.relaxed_pose()[h]
    flat, bent = (data.posed(pose, None, None)[1] for pose in (0 * poses, poses))
    tips = anatomy.joints[:, [6, 9, 12, 15]]
    drop = flat[tips][..., 1] - bent[tips][..., 1]  # palms face down in the T-pose
    assert (drop > 0.01).all()
    np.testing.assert_allclose(drop[0], drop[1], atol=2e-3)  # the body's two hands mirror each other but for rounding


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_fingers_that_close_are_found_from_their_landmarks(data, one_thread, noise):
    truth, trans = fists(data, 8), np.zeros((8, 3))
    start = truth.copy()
    start[:, 22:] = 0
    hands = seen_hands(data, CAMERA, truth, trans, noise)
    fit = fit_hands(data, [CAMERA], [hands], start, trans, np.zeros(10), 15.0)
    before, after = finger_error(data, start, truth), finger_error(data, fit.poses, truth)
    # measured 0.2 and 0.25 of it; one camera does not see depth, so it is never nothing
    assert after < 0.5 * before
    assert (fit.seen == 1).all()
    assert fit.sentences() == []
    np.testing.assert_array_equal(fit.poses[:, :18], start[:, :18])


def test_hands_too_small_hang_relaxed_and_it_is_said(data):
    truth, trans = fists(data, 4), np.zeros((4, 3))
    hands = seen_hands(data, CAMERA, truth, trans)
    hands.size[:] = 20.0
    fit = fit_hands(data, [CAMERA], [hands], truth, trans, np.zeros(10), 15.0)
    anatomy = hand_anatomy(data, None)
    np.testing.assert_allclose(fit.poses[0, anatomy.joints[0, 1:]], anatomy.relaxed_pose()[0], atol=1e-5)
    np.testing.assert_array_equal(fit.poses[:, :22], truth[:, :22])
    assert "20 pixels long" in fit.sentences()[0]


def test_landmarks_of_the_other_hand_are_given_to_it(data, one_thread):
    truth, trans = fists(data, 4), np.zeros((4, 3))
    hands = seen_hands(data, CAMERA, truth, trans)
    swapped = HandLandmarks(hands.image[:, ::-1], hands.world[:, ::-1], hands.weight, hands.size)
    found = [fit_hands(data, [CAMERA], [h], truth, trans, np.zeros(10), 15.0).poses for h in (hands, swapped)]
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


def test_a_crop_is_laid_upright_around_the_hand():
    region = guided(np.array([100.0, 100]), np.array([100.0, 60]), np.array([100.0, 60]))
    assert region.angle == pytest.approx(0)  # fingers up
    assert region.side == pytest.approx(2.7 * 80)
    np.testing.assert_allclose(region.centre, [100, 60 - SHIFT * 80])
    lying = guided(np.array([100.0, 100]), np.array([140.0, 100]), np.array([140.0, 100]))
    assert lying.angle == pytest.approx(np.pi / 2)  # fingers to the right
    points = np.array([[100.0, 100], [140, 90], [140, 110]])
    box = upright(points, np.array([1.0, 0]), 2.0)
    assert box.side == pytest.approx(80)
    np.testing.assert_allclose(box.centre, [120 + SHIFT * 40, 100])


@pytest.mark.parametrize("layout", ["sides", "openpose", "wholebody"])
def test_hands_are_read_from_files_in_three_orders(tmp_path, layout):
    rng = np.random.default_rng(0)
    points = rng.uniform(1, 100, (3, 2, 21, 3))
    points[..., 2] = 0.8
    if layout == "wholebody":
        whole = np.zeros((3, 133, 3))
        whole[:, 91:112], whole[:, 112:133] = points[:, 0], points[:, 1]
        arrays = {"wholebody": whole}
    else:
        shape = (3, 63) if layout == "openpose" else (3, 21, 3)
        arrays = {f"{side}_hand": points[:, h].reshape(shape) for h, side in enumerate(SIDES)}
    hands = read_hands(tmp_path / "landmarks.npz", arrays, np.full(3, 300.0))
    np.testing.assert_allclose(hands.image, points[..., :2])
    np.testing.assert_allclose(hands.weight, 0.8)
    np.testing.assert_allclose(hands.size, 54)  # 0.18 m
    assert PLACE["index4"] == 8
    assert len(FINGERS) == 5


def test_files_without_hands_have_none_and_wrong_ones_are_one_sentence(tmp_path):
    path = tmp_path / "landmarks.npz"
    assert read_hands(path, {"image": np.zeros((3, 33, 4))}, np.ones(3)) is None
    with pytest.raises(UserError, match=r"'left_hand' has shape \(3, 20, 3\)"):
        read_hands(path, {"left_hand": np.zeros((3, 20, 3))}, np.ones(3))
    broken = np.ones((3, 21, 3))
    broken[1, 4, 0] = np.nan
    with pytest.raises(UserError, match="NaN in frame 1, point 4"):
        read_hands(path, {"right_hand": broken}, np.ones(3))


def test_a_persons_size_in_pixels_counts_only_points_that_were_seen():
    world = np.random.default_rng(0).normal(size=(33, 3))
    image = 250 * world[:, :2] + 100
    image[5] = 0
    seen = np.arange(33) != 5
    assert pixels_per_metre(image, world, seen) == pytest.approx(250)


def test_knuckles_lie_where_the_body_in_the_picture_has_them(data):
    capture, anatomy = read_capture(DEMO), hand_anatomy(data, None)
    with np.load(DEMO / "body_truth.npz") as file:
        truth = {key: file[key] for key in file.files}
    frames, misses = (0, 20, 40), []
    networks, tracker = PoseNetworks(), HandTracker(HandNetworks(), 3)
    for k, t in enumerate(frames):
        image = picture(t)
        first = networks.landmarks(image, networks.detect(image)[0].region)
        tracker.look(k, image, networks.landmarks(image, first.following))
        joints = data.posed(truth["poses"][t].reshape(-1, 3), truth["betas"].reshape(-1), truth["trans"][t])[1]
        knuckles = capture.cameras["cam0"].project(joints[anatomy.joints[:, [4, 7, 10, 13]]])[..., :2]
        for h in np.flatnonzero(tracker.found.weight[k] > 0):
            misses.append(np.linalg.norm(tracker.found.image[k, h][[5, 9, 13, 17]] - knuckles[h], axis=-1).mean())
    assert len(misses) == 6
    assert max(misses) < 4  # pixels; hands are 22 pixels long here, four knuckles span 9. Measured: 1.2 to 2.1
