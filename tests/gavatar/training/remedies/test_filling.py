"""Points that no view saw take on what is around them, and how much of the views each point makes up."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import LevelConfig, check, compose_config
from gavatar.training.footage import FootageSource
from gavatar.training.remedies import filling
from gavatar.training.remedies.evidence import blending_weights, view_weights
from gavatar.training.remedies.filling import fill_unseen, harmonic
from gavatar.training.scene import Scene
from gavatar.training.trainer import Trainer
from gavatar.training.verdicts import FillingVerdict

STATIC = [*(o for o in SMALL if not o.startswith("encoder")), "encoder=none", "motion.guard=false"]


@pytest.fixture
def scene(tmp_path):
    capture = write_tiny_capture(tmp_path / "tiny")
    config = check(compose_config([f"capture={capture}", "out=x", *STATIC]))
    made = Trainer(config, tmp_path / "run").scene
    made.place(LevelConfig(gaussians=2850))
    return made


def test_blending_weights_add_up_to_the_silhouette(scene):
    weight = view_weights(scene, 2, 0.25)
    with torch.no_grad():
        _, alpha = scene.render([2], 0.25, scene.avatar.attributes())
    _, mask = scene.footage.at(0.25).batch([2], torch.zeros(3), torch.device("cpu"))
    # float32 sums over a few thousand pixels
    assert float(weight.sum()) == pytest.approx(float((alpha * mask).sum()), rel=1e-4)
    assert (weight >= 0).all()
    # what one camera does not see has no weight
    assert (weight == 0).float().mean() > 0.2
    total = blending_weights(scene, 0.25)
    assert (total >= weight).all()
    assert (total == 0).float().mean() < (weight == 0).float().mean()


def test_the_continuation_is_smooth_between_what_is_known():
    points = np.stack([np.linspace(0, 1, 41), np.zeros(41), np.zeros(41)], -1)
    values = np.stack([np.linspace(0, 1, 41), np.full(41, 0.3)], -1)
    known = (points[:, 0] < 0.25) | (points[:, 0] > 0.75)
    garbage = np.where(known[:, None], values, 9.0)
    filled = harmonic(points, garbage, known)
    np.testing.assert_allclose(filled[known], values[known])
    np.testing.assert_allclose(filled[:, 1], 0.3, atol=1e-3)  # a constant is continued as itself
    assert (np.diff(filled[:, 0]) > 0).all()
    # eight neighbours reach over the border of what is known by four points, a tenth of the line
    assert np.abs(filled[:, 0] - values[:, 0]).max() < 0.1


def test_a_part_without_any_known_neighbour_gets_the_mean():
    points = np.concatenate([np.random.default_rng(0).random((30, 3)), 100 + np.random.default_rng(1).random((20, 3))])
    known = np.arange(50) < 30
    values = np.arange(50.0)[:, None]
    np.testing.assert_allclose(harmonic(points, values, known)[30:], 14.5, atol=1e-3)


@pytest.mark.parametrize("known", [np.zeros(4, bool), np.ones(4, bool)])
def test_nothing_is_continued_where_all_or_nothing_is_known(known):
    values = np.arange(4.0)[:, None]
    assert harmonic(np.eye(4, 3), values, known) is values


def test_unseen_points_take_on_their_surroundings_and_seen_ones_stay_exactly(scene):
    avatar, footage = scene.avatar, FootageSource(scene.footage.capture, scene.views[:1])
    front = Scene(scene.built, scene.rasterize, footage, scene.motion)  # one side of the person
    with torch.no_grad():
        avatar.features.normal_()  # noise, as it is left where no image tells otherwise
        avatar.decoder.heads["color"][2].weight.normal_(std=0.5)
        before = avatar.attributes()
    seen = blending_weights(front, 0.25) >= 1
    verdict = fill_unseen(front, 0.25)
    with torch.no_grad():
        after = avatar.attributes()
    assert verdict.points == verdict.filled == int((~seen).sum()) > 500
    assert verdict.of == len(seen)
    for name in ("colors", "offsets", "scales"):
        assert torch.equal(getattr(before, name)[0, seen], getattr(after, name)[0, seen])
    known = seen.numpy()
    target = torch.from_numpy(harmonic(avatar.surface.points, before.colors[0].numpy(), known))[~seen]
    error = [(out.colors[0, ~seen] - target).abs().mean() for out in (before, after)]
    assert error[1] < 0.3 * error[0]


def test_a_capture_seen_from_all_sides_is_not_changed(scene, monkeypatch):
    monkeypatch.setattr(filling, "blending_weights", lambda scene, scale: torch.full((len(scene.avatar.surface),), 9.0))
    before = scene.avatar.features.clone()
    assert fill_unseen(scene, 0.25) == FillingVerdict(points=0, of=len(scene.avatar.surface), filled=0)
    assert torch.equal(before, scene.avatar.features)
