"""Footage that shows half a person is fitted where it shows something; the rest rests, and is said to."""

import dataclasses

import numpy as np
import pytest
from known_people import FPS, QUICK, cameras_around, masks_of, plausible_motion, seen_by

from gavatar.preparation.anatomy import joint_ranges
from gavatar.preparation.coverage import covered
from gavatar.preparation.fit import BodyFitter
from gavatar.preparation.landmarks import INDEX
from gavatar.preparation.pipeline import require_meeting
from gavatar.preparation.silhouette import prepare_silhouettes
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.camera import Camera

pytestmark = pytest.mark.usefixtures("one_thread")
LEGS = ("hip", "knee", "ankle", "foot")


def cut(marks, camera, height):
    """The camera's picture cut off at a row, and what a network says then: points out of the picture are guessed 60
    pixels off, with hardly any certainty."""
    camera = Camera(camera.width, height, camera.fx, camera.fy, camera.cx, camera.cy, camera.T_camera_world)
    out = marks.image[..., 1] > height
    visibility = np.where(out, 0.1, marks.visibility)
    image = marks.image + np.where(out[..., None], [60.0, 0.0], 0.0)
    return camera, dataclasses.replace(marks, image=image, visibility=visibility, height=height)


@pytest.fixture(scope="module")
def bust(data):
    """A turn seen down to the chest by a camera of 256 x 115 pixels: truth, camera, landmarks, masks."""
    truth, (camera,) = plausible_motion(data, frames=8, turn=1.5), cameras_around(1)
    masks = [mask[:115] for mask in masks_of(data, camera, truth)]
    return truth, *cut(seen_by(camera, truth), camera, 115), masks


def test_head_and_shoulders_are_fitted_and_legs_rest(data, bust):
    truth, camera, marks, masks = bust
    coverage = covered([camera], [marks])
    assert {f"{side}_{part}" for side in ("left", "right") for part in LEGS} <= set(coverage.resting)
    assert coverage.fitted in ("head and shoulders", "upper body")
    assert "never seen, so at rest: legs" in coverage.sentence()
    silhouettes = [prepare_silhouettes(masks, (256, 115))]
    fit = BodyFitter(data, [camera], [marks], silhouettes, FPS, QUICK).run(progress=False)
    require_meeting(fit, [camera], [marks])
    assert np.nanmedian(fit.image_error) < 4  # pixels: 1 px of noise, and what limits and priors hold back
    assert np.isnan(fit.image_error[0, :, INDEX["left_knee"]]).all()
    _, _, mean, _ = joint_ranges(tuple(data.joint_names))
    resting = [list(data.joint_names).index(name) for name in coverage.resting]
    # float32 and a turn to axis-angle: one part in 1e7 of at most 1 rad
    np.testing.assert_allclose(fit.poses[:, resting], np.broadcast_to(mean[resting], (8, len(resting), 3)), atol=1e-6)
    upper = [list(data.joint_names).index(name) for name in ("head", "left_shoulder", "right_shoulder")]
    found = np.array([data.posed(p, fit.betas, t)[1] for p, t in zip(fit.poses, fit.trans, strict=True)])
    off = (found[:, upper] - found[:, [12]]) - (truth.joints[:, upper] - truth.joints[:, [12]])
    assert np.linalg.norm(off, axis=-1).mean() < 0.06  # measured 0.03 m


def test_the_whole_body_is_called_whole(data):
    truth, (camera,) = plausible_motion(data, frames=4), cameras_around(1)
    coverage = covered([camera], [seen_by(camera, truth)])
    assert coverage.whole
    assert coverage.sentence() is None
    assert coverage.fitted == "whole body"


def test_a_hand_that_is_never_seen_rests_alone(data):
    truth, (camera,) = plausible_motion(data, frames=4), cameras_around(1)
    marks = seen_by(camera, truth)
    visibility = marks.visibility.copy()
    visibility[:, [INDEX["left_index"], INDEX["left_pinky"]]] = 0.1
    coverage = covered([camera], [dataclasses.replace(marks, visibility=visibility)])
    assert coverage.resting == ("left_wrist",)
    assert coverage.sentence() == "fitted: whole body; never seen, so at rest: left hand"


def test_a_body_that_lies_beside_its_landmarks_is_refused(data, bust):
    _, camera, marks, _ = bust
    fit = BodyFitter(data, [camera], [marks], None, FPS, dataclasses.replace(QUICK, steps=(10, 10, 1)))
    fit = fit.run(progress=False)
    off = dataclasses.replace(fit, image_error=fit.image_error + 118)
    with pytest.raises(UserError, match=r"does not fit what was found: its landmarks are off by 1\d\d pixels"):
        require_meeting(off, [camera], [marks])
    nothing = dataclasses.replace(fit, image_error=np.full_like(fit.image_error, np.nan))
    with pytest.raises(UserError, match="film at least head and shoulders"):
        require_meeting(nothing, [camera], [marks])


def test_without_shoulders_nothing_is_fitted(data):
    truth, (camera,) = plausible_motion(data, frames=2), cameras_around(1)
    marks = seen_by(camera, truth)
    visibility = marks.visibility.copy()
    visibility[:, [INDEX["left_shoulder"], INDEX["right_shoulder"]]] = 0
    with pytest.raises(UserError, match="the landmarks show the shoulders in no frame"):
        BodyFitter(data, [camera], [dataclasses.replace(marks, visibility=visibility)], None, FPS, QUICK)
