"""A camera that is held by hand: how it turns is found from the room, and the body stands still in it."""

import json
import shutil

import cv2
import numpy as np
import pytest
from known_people import FPS, QUICK, joint_error, masks_of, plausible_motion, seen_by
from tiny_capture import write_tiny_capture

from gavatar.capture.capture import View, read_capture
from gavatar.preparation.fit import BodyFitter
from gavatar.preparation.handheld.room_motion import RoomMotion, measure_room_motion
from gavatar.preparation.handheld.turning_camera import turning_camera
from gavatar.preparation.silhouette import prepare_silhouettes
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.values.camera import Camera, look_at

pytestmark = pytest.mark.usefixtures("one_thread")
SIZE, FOCAL = (256, 192), 380.0
CENTRES = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])


def path(count=12):
    """(T, 3, 3) turns, by up to 12 degrees, and (T,) focal lengths."""
    time = np.linspace(0, 1, count)
    angles = np.stack([0.04 * np.sin(9 * time), 0.2 * time, 0.03 * np.cos(7 * time)], -1)
    return matrix_from_axis_angle(angles), FOCAL * np.exp(0.05 * np.sin(3 * time))


def matrix(focal):
    return np.array([[focal, 0, SIZE[0] / 2], [0, focal, SIZE[1] / 2], [0, 0, 1.0]])


def homographies(turns, focals):
    """(T, 3, 3) from pixels of the first frame's camera to those of each."""
    first = np.linalg.inv(matrix(focals[0]) @ turns[0])
    return np.array([matrix(f) @ R @ first for R, f in zip(turns, focals, strict=True)])


@pytest.fixture(scope="module")
def room():
    """A wall of 700 x 500 pixels full of corners."""
    rng = np.random.default_rng(0)
    blocks = rng.uniform(20, 235, (50, 70, 3)).astype(np.float32)
    return np.uint8(np.clip(cv2.resize(blocks, (700, 500), interpolation=cv2.INTER_LINEAR), 0, 255))


def test_turns_and_zoom_are_measured_from_the_room(room):
    turns, focals = path()
    H, shift = homographies(turns, focals), np.array([[1, 0, -150], [0, 1, -150], [0, 0, 1.0]])
    images, masks = [], []
    for t, h in enumerate(H):
        image = cv2.warpPerspective(room, np.linalg.inv(CENTRES) @ h @ shift @ CENTRES, SIZE)
        mask = np.zeros(SIZE[::-1], np.uint8)
        cv2.ellipse(mask, (60 + 10 * t, 100), (25, 70), 0, 0, 360, 255, -1)  # somebody who walks the other way
        image[mask > 0] = (60 + 40 * np.sin(np.arange((mask > 0).sum())))[:, None]
        images.append(image)
        masks.append(mask)
    motion = measure_room_motion(images, masks)
    assert motion.miss < 0.002  # half a pixel
    middle = focals[motion.reference]
    camera = turning_camera(motion, Camera(*SIZE, middle, middle, SIZE[0] / 2, SIZE[1] / 2, np.eye(4)))
    off = camera.rotations @ camera.rotations[0].T @ (turns @ turns[0].T).transpose(0, 2, 1)
    angles = np.degrees(np.linalg.norm(axis_angle_from_matrix(off), axis=-1))
    assert angles.max() < 0.2  # measured 0.05; a pixel is 0.15 degrees
    np.testing.assert_allclose(camera.focal / camera.focal[0], focals / focals[0], atol=0.01)


def test_a_wall_without_corners_says_nothing():
    images, masks = [np.full((96, 128, 3), 120, np.uint8)] * 4, [np.zeros((96, 128), np.uint8)] * 4
    assert measure_room_motion(images, masks) is None


def test_part_of_a_motion_starts_in_its_own_middle():
    motion = RoomMotion(homographies(*path(9)), 0, 0.0)
    part = motion.taken(slice(2, 7))
    assert part.reference == 2
    np.testing.assert_allclose(part.to_frame[2], np.eye(3), atol=1e-12)
    step = part.to_frame[3] / part.to_frame[3][2, 2]
    expected = motion.to_frame[5] @ np.linalg.inv(motion.to_frame[4])
    np.testing.assert_allclose(step, expected / expected[2, 2], atol=1e-9)


def test_the_body_is_fitted_in_a_room_that_stands_still(data):
    # without the camera's turn of 12 degrees the body would walk 0.8 m to the side
    truth = plausible_motion(data, frames=12, turn=1.0)
    turns, focals = path()
    place = look_at((0, 0.1, 4.0), (0, -0.1, 0))
    marks, masks = [], []
    for t, (R, focal) in enumerate(zip(turns, focals, strict=True)):
        T = place.copy()
        T[:3] = R @ T[:3]
        camera = Camera(*SIZE, focal, focal, SIZE[0] / 2, SIZE[1] / 2, T)
        marks.append(seen_by(camera, truth, seed=t)[t : t + 1])
        masks.append(masks_of(data, camera, truth)[t])
    arrays = {name: np.concatenate([getattr(m, name) for m in marks]) for name in ("image", "visibility", "world")}
    moved = type(marks[0])(**arrays, fps=FPS, width=SIZE[0], height=SIZE[1])
    guess = Camera(*SIZE, FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2, place)
    turning = turning_camera(RoomMotion(homographies(turns, focals), 0, 0.0).taken(slice(None)), guess)
    steady = [turning.steadied(moved)]
    silhouettes = [prepare_silhouettes(turning.steadied_masks(masks), (turning.still.width, turning.still.height))]
    fit = BodyFitter(data, [turning.still], steady, silhouettes, FPS, QUICK).run(progress=False)
    assert joint_error(data, fit, truth) < 0.09  # 0.063 with a camera that stands still (test_body_fit), plus a third
    walked = (
        fit.trans
        - fit.trans[0]
        - (truth.trans - truth.trans[0]) @ (place[:3, :3].T @ turns[6][:3, :3].T @ place[:3, :3]).T
    )
    assert np.abs(walked[:, 0]).max() < 0.15
    for t, camera in enumerate(turning.frames(turning.still)):  # what the frames' cameras see is what was marked
        pixels = camera.project(data.posed(fit.poses[t], fit.betas, fit.trans[t])[1][:1])[0, :2]
        hips = moved.image[t, [23, 24]].mean(0)
        assert np.linalg.norm(pixels - hips) < 15  # pixels, 0.15 m: the pelvis lies above the hips' middle


def test_a_capture_has_a_pose_a_frame(tmp_path):
    folder = write_tiny_capture(tmp_path / "tiny")
    cameras = json.loads((folder / "cameras.json").read_text())
    T = np.array(cameras["cam0"]["world_to_camera"])
    poses = np.repeat(T[None], 8, 0)
    poses[:, 0, 3] += np.arange(8)
    fx = cameras["cam0"]["fx"] * np.linspace(1, 1.1, 8)
    cameras["cam0"]["per_frame"] = {"world_to_camera": poses.tolist(), "fx": fx.tolist()}
    (folder / "cameras.json").write_text(json.dumps(cameras))
    capture = read_capture(folder)
    camera = capture.camera(View("cam0", 5))
    assert camera.T_camera_world[0, 3] == T[0, 3] + 5
    assert camera.fx == fx[5]
    assert camera.cx == capture.cameras["cam0"].cx
    assert capture.resized(0.5).camera(View("cam0", 5)).fx == pytest.approx(fx[5] / 2)
    wrong = tmp_path / "wrong"
    shutil.copytree(folder, wrong)
    cameras["cam0"]["per_frame"]["fx"] = fx[:3].tolist()
    (wrong / "cameras.json").write_text(json.dumps(cameras))
    with pytest.raises(UserError, match=r"per_frame.fx must hold finite numbers of shape \(8,\)"):
        read_capture(wrong)
