"""The scene: what is drawn in a view is the plain composition of its parts, each applied once."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.avatar.trainable import Pose
from gavatar.config import LevelConfig, check, compose_config
from gavatar.training.footage import Comparison, FootageSource
from gavatar.training.motion_table import MotionTable
from gavatar.training.scene import Scene
from gavatar.training.trainer import Trainer
from gavatar_runtime.values.motion import Motion

SCALE = 0.25
BACKGROUND = torch.tensor([0.2, 0.5, 0.9])


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


@pytest.fixture
def make(capture, tmp_path):
    """A scene with the given options, everything in it moved from where it starts."""

    def made(*overrides) -> Scene:
        overrides = [f"capture={capture}", "out=x", *SMALL, *overrides]
        scene = Trainer(check(compose_config(overrides)), tmp_path / "run").scene
        scene.place(LevelConfig(gaussians=2850))
        generator = torch.Generator().manual_seed(0)
        parts = [(scene.avatar, 0.02), (scene.motion, 0.05), (scene.exposure, 0.3), (scene.shape, 0.3)]
        for part, size in parts:
            for parameter in part.requires_grad_(False).parameters() if part is not None else ():
                parameter += size * torch.randn(parameter.shape, generator=generator)
        return scene

    return made


@pytest.mark.parametrize("options", [[], ["exposure=true"], ["motion.betas=true"], ["crop=false"],
                                     ["exposure=true", "motion.betas=true"]])  # fmt: skip
def test_a_view_is_the_plain_composition_of_avatar_camera_exposure_and_belief(make, options):
    scene, rows = make(*options), [3, 0]
    footage = scene.footage.at(SCALE)
    # no two cameras alike
    footage.cameras = [c.cropped(row, 0, c.width, c.height) for row, c in enumerate(footage.cameras)]
    attributes = scene.avatar.attributes(scene.pose_features(scene.frames_of(rows)))
    seen = scene.compare(rows, SCALE, attributes, background=BACKGROUND)
    for b, row in enumerate(rows):
        one = dataclasses.replace(attributes, **{
            name: value[b : b + 1] for name, value in vars(attributes).items() if value is not None
        })  # fmt: skip
        change = None if scene.shape is None else scene.shape.change
        (gaussians,) = scene.avatar.pose(one, scene.motion([footage.views[row].frame]), change)
        drawn = scene.rasterize(gaussians, footage.cameras[row], BACKGROUND)
        color, alpha = drawn.color.permute(2, 0, 1), drawn.alpha
        if scene.exposure is not None:
            behind = (1 - alpha) * BACKGROUND[:, None, None]
            log_gain = scene.exposure.log_gain
            color = (log_gain[row] - log_gain.mean(0)).exp()[:, None, None] * (color - behind) + behind
        mask = footage.alpha[row] / 255
        target = footage.color[row] / 255 + (1 - mask) * BACKGROUND[:, None, None]
        # float32 sums in another order; poses by the batch or one by one
        for got, expected in ((seen.render, color), (seen.alpha, alpha), (seen.target, target), (seen.mask, mask)):
            torch.testing.assert_close(got[b], expected, atol=2e-5, rtol=0)


def test_the_exposure_is_applied_once_and_in_training_views_only(make):
    scene = make("exposure=true")
    attributes, pose = scene.avatar.attributes(), scene.motion(scene.frames_of([1]))
    taken, _ = scene.render([1], SCALE, attributes, background=torch.zeros(3))
    own, _ = scene.draw(attributes, pose, [scene.footage.at(SCALE).cameras[1]], torch.zeros(3))
    torch.testing.assert_close(taken, scene.exposure.gains([1])[:, :, None, None] * own)
    assert not torch.allclose(taken, own, atol=1e-2)
    scene.exposure = None
    assert torch.equal(scene.render([1], SCALE, attributes, background=torch.zeros(3))[0], own)


def test_a_pose_given_takes_the_place_of_the_frames_own(make):
    scene = make()
    attributes = scene.avatar.attributes()
    as_refined, _ = scene.render([2], SCALE, attributes)
    as_given, _ = scene.render([2], SCALE, attributes, pose=scene.motion.estimated([2]))
    assert not torch.equal(as_refined, as_given)
    scene.motion.rotation_correction[2], scene.motion.trans_correction[2] = 0, 0
    # the estimate, or the estimate times the identity
    torch.testing.assert_close(scene.render([2], SCALE, attributes)[0], as_given, atol=1e-6, rtol=0)


def test_a_moved_pose_is_looked_at_anew_and_no_other(make):
    scene = make()
    first = scene.encoder_inputs([0, 1])
    scene.motion.rotation_correction[[0, 1], 1] += 0.5
    assert all(map(torch.equal, scene.encoder_inputs([0, 1]), first))  # kept, until it is said
    scene.moved([0])
    for before, after in zip(first, scene.encoder_inputs([0, 1]), strict=True):
        assert not torch.equal(before[0], after[0])
        assert torch.equal(before[1], after[1])
    scene.moved([0, 4])  # a frame that nobody looked at may move too


def test_a_settled_shape_is_part_of_the_body_and_drawn_once(make):
    scene = make("motion.betas=true")
    attributes = scene.avatar.attributes()
    looked_at, before = scene.encoder_inputs([0]), scene.render([0], SCALE, attributes)[0]
    change = scene.betas_change
    verdict = scene.settle_shape()
    assert scene.betas_change is None
    np.testing.assert_allclose(np.subtract(verdict.refined, verdict.estimated)[: len(change)], change, atol=1e-4)
    np.testing.assert_allclose(scene.motion.betas, scene.built.betas.astype(np.float32))
    assert not torch.equal(scene.encoder_inputs([0])[0], looked_at[0])  # maps of another body
    scene.place(LevelConfig(gaussians=2850))
    after = scene.render([0], SCALE, attributes)[0]
    # the same skin by directions of the shape and sampled afresh: a fraction of a millimetre moves few pixels
    assert (before - after).abs().mean() < 1e-3


def test_errors_are_those_of_the_views_compared_and_leave_the_avatar_as_it_was(make):
    scene, rows = make(), [4, 1]
    scene.avatar.train()
    errors = scene.errors(rows, SCALE)
    assert scene.avatar.training
    scene.avatar.eval()
    seen = scene.compare(rows, SCALE, scene.avatar.attributes())
    # float32 means of some ten thousand squares in another order
    np.testing.assert_allclose(errors, (seen.render - seen.target).square().mean((1, 2, 3)), rtol=1e-5)
    of_dynamics = scene.errors(rows, SCALE, dynamic=True)
    assert (errors != of_dynamics).all()
    assert scene.errors([], SCALE).shape == (0,)


def test_a_finer_pixel_widens_what_is_drawn_only_where_it_is_told(make):
    scene = make()
    camera = scene.footage.at(SCALE).cameras[0].scaled(4)
    pose, attributes = scene.motion([0]), scene.avatar.attributes()
    plain, wide = (scene.draw(attributes, pose, [camera], pixel=pixel)[1] for pixel in (None, 0.05))
    assert wide.sum() > plain.sum()
    assert torch.equal(plain, scene.draw(attributes, pose, [camera])[1])


def test_images_are_decoded_once_and_when_they_are_asked_for(capture, make):
    filmed, read = make().footage.capture, []
    watched = FootageSource(filmed, filmed.views("train"), bar=lambda views: read.append(len(views)) or views)
    assert read == []
    half = watched.at(0.5)
    assert watched.at(0.5) is half
    assert watched.at(0.25).cameras[0].width < half.cameras[0].width
    assert read == [6]


def test_views_joined_are_the_views_compared_together(make):
    scene = make()
    attributes = scene.avatar.attributes()
    parts = [scene.compare([row], SCALE, attributes) for row in (0, 5)]
    together, joined = scene.compare([0, 5], SCALE, attributes), Comparison.joined(parts)
    for name, values in vars(together).items():
        torch.testing.assert_close(getattr(joined, name), values, atol=1e-6, rtol=0)  # posed by two or one by one


@pytest.mark.parametrize("expression", [None, np.arange(6, dtype=np.float32).reshape(3, 2)])
def test_rows_of_a_pose_keep_all_that_travels_with_it(expression):
    poses, trans = np.zeros((3, 24, 3), np.float32), np.arange(9, dtype=np.float32).reshape(3, 3)
    poses[:, 1, 0] = [0, np.pi, -np.pi]
    table = MotionTable(Motion(poses, trans, 30.0, np.zeros(10, np.float32), "e", expression=expression), 24)
    pose = table()
    assert len(pose) == 3
    for rows in ([2, 0], slice(1, 3), []):
        part, own = pose[rows], table(rows)
        assert len(part) == len(rows if isinstance(rows, list) else range(1, 3))
        for field in dataclasses.fields(Pose):
            value, expected = getattr(part, field.name), getattr(own, field.name)
            assert (value is None) == (expected is None) == (field.name == "expression" and expression is None)
            assert value is None or torch.equal(value, expected)
