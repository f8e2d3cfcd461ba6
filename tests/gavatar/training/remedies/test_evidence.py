"""What the views of a scene say of each point, and that it is carried whole to wherever it is wanted."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from surfaces import free_surface
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import LevelConfig, check, compose_config
from gavatar.training.footage import FootageSource
from gavatar.training.remedies.evidence import (
    evidence_of,
    pose_labels,
    ramp,
    sphere,
    view_weights,
)
from gavatar.training.remedies.evidence_picture import evidence_colors, evidence_picture
from gavatar.training.remedies.facing import squareness
from gavatar.training.remedies.placed_evidence import PlacedEvidence
from gavatar.training.scene import Scene
from gavatar.training.trainer import Trainer
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.point_evidence import FULL, Evidence

STATIC = [*(o for o in SMALL if not o.startswith("encoder")), "encoder=none", "motion.guard=false"]


@pytest.fixture
def scene(tmp_path):
    capture = write_tiny_capture(tmp_path / "tiny")
    config = check(compose_config([f"capture={capture}", "out=x", *STATIC]))
    made = Trainer(config, tmp_path / "run").scene
    made.place(LevelConfig(gaussians=2850))
    return made


def some(views) -> Evidence:
    views = np.asarray(views, np.float32)
    ones = np.ones(len(views), np.int32)
    return Evidence(views, views, np.ones_like(views), ones, ones)


def test_weights_of_a_view_add_up_to_the_silhouette(scene):
    weight = view_weights(scene, 2, 0.25)
    with torch.no_grad():
        _, alpha = scene.render([2], 0.25, scene.avatar.attributes())
    _, mask = scene.footage.at(0.25).batch([2], torch.zeros(3), torch.device("cpu"))
    # float32 sums over a few thousand pixels
    assert float(weight.sum()) == pytest.approx(float((alpha * mask).sum()), rel=1e-4)
    assert (weight >= 0).all()
    assert (weight == 0).float().mean() > 0.2  # what one camera does not see has no weight


def test_one_view_says_all_of_what_faces_it_and_nothing_of_the_back(scene):
    one = Scene(scene.built, scene.rasterize, FootageSource(scene.footage.capture, scene.views[:1]), scene.motion)
    found = evidence_of(one, 0.25).evidence
    frame, camera = one.frames_of([0])[0], one.footage.at(0.25).cameras[0]
    facing, towards = squareness(one.avatar.surface, one.motion.motion(), frame, camera)
    np.testing.assert_allclose(np.linalg.norm(towards, axis=1), 1, rtol=1e-6)
    assert len(found) == len(scene.avatar.surface)
    total = view_weights(one, 0, 0.25).numpy()
    assert found.pixels.sum() < total.sum()
    square = facing > 0.5  # counted in full
    np.testing.assert_allclose(found.pixels[square], total[square], rtol=1e-4, atol=1e-6)
    assert found.pixels[facing < -0.2].sum() < 0.02 * found.pixels.sum()
    assert found.poses.max() == found.directions.max() == 1
    assert not found.poses[facing < 0].any()
    assert (found.squareness[square & (total > 0.1)] > 0.5).all()


def test_more_views_say_more(scene):
    one = Scene(scene.built, scene.rasterize, FootageSource(scene.footage.capture, scene.views[:1]), scene.motion)
    few, many = evidence_of(one, 0.25).evidence, evidence_of(scene, 0.25).evidence
    assert (many.pixels >= few.pixels - 1e-6).all()
    assert (many.poses >= few.poses).all()
    assert (many.directions >= few.directions).all()
    assert many.confidence.mean() > few.confidence.mean()


def test_what_a_cosine_counts_rises_from_slant_to_square():
    np.testing.assert_allclose(ramp(np.array([-1, 0.15, 0.325, 0.5, 1.0])), [0, 0, 0.5, 1, 1], atol=1e-12)


def test_directions_are_spread_over_the_sphere():
    directions = sphere(48)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)
    apart = np.degrees(np.arccos(np.clip(directions @ directions.T - 2 * np.eye(48), -1, 1))).min(1)
    assert apart.min() > 20
    assert apart.max() < 40


def test_a_pose_is_another_one_where_a_joint_about_the_point_turns():
    surface = free_surface(64)
    poses = np.zeros((4, surface.num_joints, 3))
    poses[1, 0, 1] = 3.0  # the whole person turns: no other pose
    poses[2, 18, 1] = 1.0  # left elbow
    poses[3, 18, 1] = 1.2  # 11 degrees further: the same again
    labels = pose_labels(surface, Motion(poses, np.zeros((4, 3)), 30.0))
    assert labels[18].tolist() == [0, 0, 1, 1]
    assert labels[20].tolist() == [0, 0, 1, 1]  # its wrist
    assert not labels[[0, 1, 2, 15, 19]].any()  # pelvis, hips, head, right elbow


def test_confidence_rises_smoothly_from_nothing_to_enough():
    confidence = some([0, FULL / 2, FULL, 1e6]).confidence
    np.testing.assert_allclose(confidence, [0, 0.5, 1, 1])


def test_evidence_is_carried_to_the_nearest_points_of_another_sampling():
    coarse, fine = free_surface(64), free_surface(96)
    placed = PlacedEvidence(coarse.points, some(coarse.points[:, 1] - coarse.points[:, 1].min()))
    assert placed.on(coarse) is placed.evidence
    on = placed.on(fine)
    assert len(on) == len(fine)
    assert np.abs(on.views - (fine.points[:, 1] - coarse.points[:, 1].min())).max() < 0.04  # a texel is 26 mm wide


def test_a_checkpoint_keeps_it_and_one_that_was_altered_is_refused():
    placed = PlacedEvidence(np.zeros((3, 3), np.float32), some([0, 1, 2]))
    again = PlacedEvidence.from_state(placed.state(), "stage1.pt")
    assert np.array_equal(again.evidence.views, placed.evidence.views)
    for name, value in (("views", torch.tensor([0, 1, float("nan")])), ("squareness", torch.tensor([0, 1, 1.5]))):
        with pytest.raises(UserError, match=f"stage1.pt: array '{name}'"):
            PlacedEvidence.from_state(placed.state() | {name: value}, "stage1.pt")


def test_the_picture_tells_seen_from_unseen(scene):
    with pytest.raises(ValueError, match="no evidence"):
        evidence_picture(scene)
    count = len(scene.avatar.surface)
    front = scene.avatar.surface.normals[:, 2] > 0
    scene.evidence = PlacedEvidence(scene.avatar.surface.points, some(np.where(front, 50.0, 0.0)))
    picture = evidence_picture(scene)
    width = picture.shape[1] // 4
    seen, unseen = (picture[:320, k * width : (k + 1) * width] for k in (0, 2))
    for side, channel in ((seen, 1), (unseen, 0)):  # green before, red behind
        body = side.min(2) < 0.6
        assert (side[body].argmax(1) == channel).mean() > 0.9
    assert evidence_colors(some([np.nan, 0])).shape == (2, 3)
    assert len(front) == count
