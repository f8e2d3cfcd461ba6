"""The person in pictures is found, followed and cut out, and what makes that hard is noted."""

import cv2
import numpy as np
import pytest
from demo_pictures import picture, true_mask
from places import DEMO

from gavatar.capture.capture import read_capture
from gavatar.preparation.detect import notes
from gavatar.preparation.draw import iou
from gavatar.preparation.landmarks import INDEX, Landmarks
from gavatar.preparation.matting import largest_piece, refine_mask
from gavatar.preparation.pose_network import (
    CROP_SIDE,
    PoseNetworks,
    Region,
    anchors,
    merge_overlapping,
    refine,
    sigmoid,
)
from gavatar.preparation.steadiness import STEADY, Steadiness
from gavatar.preparation.track import Tracked, track
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.errors import UserError


@pytest.fixture(scope="module")
def networks():
    return PoseNetworks()


def look(networks, image):
    """The landmarks of the one person in a picture."""
    (person,) = networks.detect(image)
    return networks.landmarks(image, networks.landmarks(image, person.region).following)


# ---------------------------------------------------------------- the networks


def test_landmarks_lie_on_the_joints_of_the_body_in_the_picture(networks):
    capture, body = read_capture(DEMO), load_free_body()
    with np.load(DEMO / "body_truth.npz") as file:
        truth = {key: file[key] for key in file.files}
    names = list(body.joint_names)
    for t in (0, 40, 80):
        pose = look(networks, picture(t))
        joints = body.posed(truth["poses"][t].reshape(-1, 3), truth["betas"].reshape(-1), truth["trans"][t])[1]
        seen = capture.cameras["cam0"].project(joints)[:, :2]
        for side in ("left", "right"):
            for part in ("shoulder", "elbow", "wrist", "knee", "ankle"):
                miss = pose.image[INDEX[f"{side}_{part}"], :2] - seen[names.index(f"{side}_{part}")]
                # the person is 200 px tall, one pixel 9 mm: half the width of a limb. Measured: 8.3 at most
                assert np.hypot(*miss) < 12, (t, side, part)
        assert pose.score > 0.9


def test_a_person_lying_on_their_side_gives_the_same_landmarks_turned(networks):
    image = picture(0)
    upright, turned = look(networks, image), look(networks, cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE))
    assert turned.region.angle == pytest.approx(np.pi / 2, abs=0.15)
    side = image.shape[0]
    back = np.stack([turned.image[:, 1], side - turned.image[:, 0]], -1)
    sure = upright.visibility > 0.9
    # measured 1.6 px: resampling at another phase
    assert np.median(np.linalg.norm(back - upright.image[:, :2], axis=1)[sure]) < 3
    # metres along the camera's axes turn with the image: x' = -y, y' = x
    world = np.stack([turned.world[:, 1], -turned.world[:, 0], turned.world[:, 2]], -1)
    assert np.median(np.linalg.norm(world - upright.world, axis=1)[sure]) < 0.06


def test_the_mirror_image_has_mirrored_landmarks(networks):
    image = picture(0)
    a, b = look(networks, image), look(networks, np.ascontiguousarray(image[:, ::-1]))
    left, right = INDEX["left_wrist"], INDEX["right_wrist"]
    assert b.image[left, 0] == pytest.approx(image.shape[1] - a.image[right, 0], abs=3)
    assert b.world[left] == pytest.approx(a.world[right] * [-1, 1, 1], abs=0.05)


def test_anchors_cover_the_image_evenly():
    places = anchors()
    assert places.shape == (2254, 2)  # the detector's output has as many rows
    assert places.min() > 0
    assert places.max() < 1
    np.testing.assert_allclose(places.mean(0), 0.5, atol=1e-9)


def test_overlapping_boxes_are_one_person():
    boxes = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [30, 0, 40, 10], [30, 0, 30, 0]], float)
    groups = merge_overlapping(boxes, np.array([0.7, 0.9, 0.8, 0.6]))
    assert [sorted(g.tolist()) for g in groups] == [[0, 1], [2], [3]]
    assert merge_overlapping(boxes[:0], np.zeros(0)) == []


def test_refining_moves_a_point_to_its_peak_and_leaves_it_without_one():
    heat = np.full((64, 64, 39), -20.0)
    heat[20, 31, 0] = 5
    moved = refine(np.tile([120.0, 84.0], (39, 1)), heat)
    np.testing.assert_allclose(moved[0], [124, 80], atol=0.1)  # cells of 4 pixels
    np.testing.assert_array_equal(moved[1], [120, 84])
    outside = np.tile([-50.0, 1e9], (39, 1))
    np.testing.assert_array_equal(refine(outside, heat), outside)


def test_the_logistic_function_overflows_for_no_input():
    with np.errstate(all="raise"):
        np.testing.assert_allclose(sigmoid(np.array([-1e30, 0, 1e30])), [0, 0.5, 1])


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi, -2.0])
def test_a_crop_pasted_back_falls_where_it_was(angle):
    region = Region(np.array([60.0, 50.0]), 70.0, angle)
    image = np.zeros((100, 120), np.float32)
    cv2.circle(image, (64, 45), 9, 1.0, -1)
    back = region.paste(region.crop(image), 120, 100)
    assert iou(back > 0.5, image > 0.5) > 0.9
    M = region.to_image()
    np.testing.assert_allclose(M @ [CROP_SIDE / 2, CROP_SIDE / 2, 1], [60, 50])
    assert np.linalg.det(M[:, :2]) == pytest.approx((70 / CROP_SIDE) ** 2)


# ---------------------------------------------------------------- masks


def test_the_mask_agrees_with_the_true_one(networks):
    for t, least in ((0, 0.97), (15, 0.97), (60, 0.95)):
        image = picture(t)
        pose = look(networks, image)
        coarse = pose.region.paste(pose.outline.astype(np.float32), image.shape[1], image.shape[0])
        mask = refine_mask(image, coarse) > 127
        assert iou(mask, true_mask(t)) > max(least, iou(coarse > 0.5, true_mask(t)))  # better than before, too


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (64, 64)])
def test_masks_of_nothing_and_of_everything(shape):
    image = np.full((*shape, 3), 128, np.uint8)
    assert not refine_mask(image, np.zeros(shape, np.float32)).any()
    full = refine_mask(image, np.ones(shape, np.float32))
    assert full.shape == shape
    assert full.dtype == np.uint8
    assert min(shape) < 4 or (full == 255).all()


def test_specks_are_dropped_and_large_pieces_kept():
    mask = np.zeros((40, 40), np.uint8)
    mask[:20, :20], mask[30:38, 30:38], mask[39, 0] = 1, 1, 1
    kept = largest_piece(mask)
    assert kept[35, 35] == 1
    assert kept[39, 0] == 0
    np.testing.assert_array_equal(largest_piece(np.zeros((4, 4), np.uint8)), 0)


# ---------------------------------------------------------------- following


def follow(networks, images) -> tuple[Tracked, dict[int, np.ndarray]]:
    masks: dict[int, np.ndarray] = {}
    found = track(lambda: iter(images), len(images), masks.__setitem__, networks, "clip", 10.0, progress=False)
    return found, masks


def test_of_two_people_the_larger_is_followed(networks):
    def both(t):
        other = cv2.resize(picture(t)[:, ::-1], (144, 144), interpolation=cv2.INTER_AREA)
        return np.hstack([np.vstack([np.full((112, 144, 3), 255, np.uint8), other]), picture(t)])

    tracked, masks = follow(networks, [both(t) for t in (0, 1)])
    assert tracked.people == 2
    for t in (0, 1):
        assert iou(masks[t][:, 144:] > 127, true_mask(t)) > 0.95
        assert not (masks[t][:, :144] > 127).any()
    assert any("2 people" in note for note in notes("clip", np.arange(2), tracked, None))


def test_frames_without_the_person_are_marked_and_the_person_found_again(networks):
    blank = np.full((256, 256, 3), 255, np.uint8)
    tracked, masks = follow(networks, [picture(0), blank, picture(2)])
    assert (tracked.landmarks.visibility[1] == 0).all()
    assert not masks[1].any()
    assert (tracked.landmarks.visibility[[0, 2]].max(1) > 0.9).all()
    assert np.isnan(tracked.sharpness[1])
    assert any("nobody is found in 1 of 3 frames (1)" in n for n in notes("clip", np.arange(3), tracked, None))


def test_nobody_at_all_is_one_sentence(networks):
    with pytest.raises(UserError, match="no person found in clip"):
        follow(networks, [np.random.default_rng(0).integers(0, 255, (80, 100, 3)).astype(np.uint8)] * 2)
    with pytest.raises(UserError, match="no person found"):
        follow(networks, [np.zeros((1, 1, 3), np.uint8)])


def test_a_cut_off_person_and_a_blurred_frame_are_noted(networks):
    images = [picture(t)[:180] for t in range(6)]  # no feet
    images[3] = cv2.GaussianBlur(images[3], (0, 0), 2.5)
    tracked, _ = follow(networks, images)
    said = " / ".join(notes("clip", np.arange(10, 16), tracked, None))
    assert "bottom edge" in said
    assert "1 of 6 frames (13) blurred" in said


def test_notes_say_nothing_of_good_footage():
    seen = Landmarks(np.ones((3, 33, 2)), np.ones((3, 33)), np.ones((3, 33, 3)))
    good = Tracked(seen, 1, np.full(3, 50.0), np.zeros((3, 4), bool))
    assert notes("clip", np.arange(3), good, 0.001) == []
    (said,) = notes("clip", np.arange(3), good, 0.1)
    assert "camera moves" in said


def scene(shift: int) -> np.ndarray:
    room = np.random.default_rng(5).integers(0, 255, (40, 60)).astype(np.uint8)
    room = cv2.resize(room, (720, 480), interpolation=cv2.INTER_NEAREST)[:, 100 + shift : 500 + shift]
    return cv2.cvtColor(room, cv2.COLOR_GRAY2BGR)


@pytest.mark.parametrize(("step", "steady"), [(0, True), (3, False)])
def test_a_moving_camera_is_noticed_and_a_moving_person_is_not(step, steady):
    watch = Steadiness()
    for t in range(8):
        image, mask = scene(step * t), np.zeros((480, 400), np.uint8)
        mask[100:400, 20 + 30 * t : 140 + 30 * t] = 255
        image[mask > 0] = np.random.default_rng(t).integers(0, 255, (int((mask > 0).sum()), 3))
        watch.add(image, mask)
    assert (watch.moved < STEADY) == steady
    if not steady:
        assert watch.moved == pytest.approx(3 * 7 / 480, rel=0.2)


def test_a_plain_wall_says_nothing_about_the_camera():
    watch = Steadiness()
    for _ in range(3):
        watch.add(np.full((50, 60, 3), 200, np.uint8), np.zeros((50, 60), np.uint8))
    assert watch.moved is None
