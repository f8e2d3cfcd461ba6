"""Where footage says little, a point looks like its surroundings; where it says enough, it stays what it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.sparse import csr_matrix
from surfaces import free_surface
from test_evidence import STATIC, some
from tiny_capture import write_tiny_capture

from gavatar.config import LevelConfig, check, compose_config
from gavatar.training.remedies.bonds import Bonds, along_limbs, bonds_of, face_of
from gavatar.training.remedies.prior import WEAK, fill, measured, smoothest, static_look
from gavatar.training.trainer import Trainer

HEAD = 15
rng = np.random.default_rng(5)


def bonds(count: int, mirrored: bool = True) -> Bonds:
    """Of points in no order, some of them without any."""
    W = np.triu(rng.random((count, count)) * (rng.random((count, count)) < 0.3), 1)
    M = np.triu(rng.random((count, count)) * (rng.random((count, count)) < 0.05), 1) * mirrored
    return Bonds(csr_matrix(W + W.T), csr_matrix(M + M.T), np.tile(np.eye(3), (count, 1, 1)))


def dense(values, confidence, made: Bonds, odd) -> np.ndarray:
    """The minimum by a dense solve of the normal equations, those that are sure eliminated by a huge evidence."""
    out = np.zeros_like(values)
    mean = (confidence[:, None] * values).sum(0) / confidence.sum()
    evidence = np.where(confidence < 0.999, confidence / np.maximum(1 - confidence, 1e-12), 1e9)
    near, mirrored = made.near.toarray(), made.mirrored.toarray()
    for channel in range(values.shape[1]):
        W = near + (-1 if odd[channel] else 1) * mirrored
        A = np.diag((near + mirrored).sum(1) + evidence + WEAK) - W
        out[:, channel] = np.linalg.solve(A, evidence * values[:, channel] + WEAK * mean[channel])
    return out


@pytest.mark.parametrize("sure", [0.0, 0.4])
def test_the_solver_finds_the_minimum_of_the_energy(sure):
    made, odd = bonds(60), np.array([False, True])
    values, confidence = rng.normal(size=(60, 2)), rng.random(60) * (rng.random(60) < 0.7)
    confidence[rng.random(60) < sure] = 1
    found = smoothest(values, confidence, made, odd)
    # conjugate gradients stop at 1e-6 of the right side; the dense reference's 1e9 adds as much
    np.testing.assert_allclose(found, dense(values, confidence, made, odd), atol=2e-5)
    assert np.array_equal(found[confidence == 1], values[confidence == 1])


def test_nothing_changes_where_nothing_or_all_was_seen():
    made, values = bonds(9), rng.normal(size=(9, 2))
    assert smoothest(values, np.zeros(9), made) is values
    assert smoothest(values, np.ones(9), made) is values


def test_values_that_are_no_numbers_count_as_unseen():
    made, values = bonds(40, mirrored=False), np.full((40, 1), 0.25)
    values[3], values[5] = np.nan, np.inf
    np.testing.assert_allclose(smoothest(values, np.ones(40), made), 0.25, atol=1e-4)
    confidence = np.ones(40)
    confidence[7] = np.nan
    assert np.isfinite(smoothest(values, confidence, made)).all()


def test_a_part_without_any_evidence_takes_the_mean_of_all():
    near = np.zeros((6, 6))
    near[:3, :3] = near[3:, 3:] = 1 - np.eye(3)
    made = Bonds(csr_matrix(near), csr_matrix((6, 6)), np.tile(np.eye(3), (6, 1, 1)))
    found = smoothest(np.array([[0.0], [1.0], [2.0], [9.0], [9.0], [9.0]]), np.array([1, 1, 1, 0, 0, 0.0]), made)
    np.testing.assert_allclose(found[3:], 1.0, atol=1e-4)


def test_it_fades_as_evidence_grows():
    near = np.array([[0.0, 1.0], [1.0, 0.0]])
    made = Bonds(csr_matrix(near), csr_matrix((2, 2)), np.tile(np.eye(3), (2, 1, 1)))
    found = [smoothest(np.array([[0.0], [1.0]]), np.array([1.0, c]), made)[1, 0] for c in np.linspace(0, 1, 21)]
    assert found[0] == pytest.approx(0, abs=1e-4)
    assert found[-1] == 1
    assert (np.diff(found) > 0).all()
    assert np.diff(found).max() < 0.1


def test_one_point_alone_stays_what_it_is():
    one = free_surface(64).take(np.array([100]))
    made = bonds_of(one, HEAD)
    assert smoothest(np.ones((1, 2)), np.array([0.5]), made) == pytest.approx(1.0)
    assert made.near.nnz == 0


def test_bonds_are_symmetric_and_stay_on_their_side_of_a_limb():
    surface = free_surface(64)
    made = bonds_of(surface, HEAD)
    for W in (made.near, made.mirrored):
        assert abs(W - W.T).max() < 1e-9
    assert made.near.sum() / len(surface) == pytest.approx(1.0)
    row, column = made.near.nonzero()
    weight = np.asarray(made.near[row, column]).ravel()
    opposite = (surface.normals[row] * surface.normals[column]).sum(1) < 0
    assert weight[opposite].sum() < 0.02 * weight.sum()
    left, right = made.mirrored.nonzero()
    mirrored = surface.points[right] * [-1, 1, 1]
    assert np.linalg.norm(surface.points[left] - mirrored, axis=1).max() < 0.1  # three spacings
    square = np.tile(np.eye(3), (len(surface), 1, 1))
    np.testing.assert_allclose(made.frames @ made.frames.transpose(0, 2, 1), square, atol=2e-3)


def test_limbs_and_trunk_run_where_they_run():
    surface = free_surface(64)
    axes = along_limbs(surface)
    joint = surface.joint_index[:, 0]
    assert np.median(axes[joint == 6][:, 1]) > 0.9  # the spine goes up
    assert np.median(axes[joint == 18][:, 0]) > 0.9  # the left forearm to the left


def test_hair_is_continued_from_the_sides_and_never_from_the_face():
    surface = free_surface(96)
    face = face_of(surface, HEAD)
    head = surface.joint_weight[:, 0] * (surface.joint_index[:, 0] == HEAD) > 0.5
    assert face.any()
    assert head[face].all()
    ears = surface.points[head][:, 2].mean()
    seen = head & (surface.points[:, 2] > ears - 0.02)  # filmed from straight before
    skin, hair, cloth = 1.0, 0.0, 0.5
    values = np.where(head, np.where(face, skin, hair), cloth)[:, None]
    found = smoothest(values, (seen | ~head).astype(float), bonds_of(surface, HEAD))
    top = surface.points[head][:, 1].max()
    back = head & (surface.points[:, 2] < ears - 0.06) & (surface.points[:, 1] > top - 0.16)
    assert back.sum() > 20
    assert found[back].max() < 0.25


def test_a_hem_that_ends_at_one_height_before_ends_there_behind():
    surface = free_surface(96)
    trunk = np.isin(surface.joint_index[:, 0], (0, 3, 6, 9))
    height = np.median(surface.points[trunk][:, 1])
    values = (surface.points[:, 1] > height).astype(float)[:, None]
    seen = ~(trunk & (surface.normals[:, 2] < 0))
    found = smoothest(values, seen.astype(float), bonds_of(surface, HEAD))[:, 0]
    behind = trunk & (surface.normals[:, 2] < -0.5)
    above, below = (behind & (s * (surface.points[:, 1] - height) > 0.06) for s in (1, -1))
    assert found[above].mean() > 0.8
    assert found[below].mean() < 0.2


@pytest.fixture
def scene(tmp_path):
    capture = write_tiny_capture(tmp_path / "tiny")
    made = Trainer(check(compose_config([f"capture={capture}", "out=x", *STATIC])), tmp_path / "run").scene
    made.place(LevelConfig(gaussians=2850))
    with torch.no_grad():
        made.avatar.features.normal_()  # noise, as it is left where no image tells otherwise
        made.avatar.decoder.heads["color"][2].weight.normal_(std=0.5)
    return made


def test_unseen_points_reach_the_prior_and_seen_ones_stay(scene):
    avatar = scene.avatar
    before = measured(avatar, static_look(avatar))[0]
    views = np.where(avatar.surface.normals[:, 2] > 0, 50.0, 0.0)
    prior = fill(avatar, some(views), HEAD)
    after = measured(avatar, static_look(avatar))[0]
    seen = torch.from_numpy(views > 0)
    assert torch.equal(prior.target[seen], before[seen])
    # texels that only seen points read are not touched; the others are held by the fit, to three 8-bit steps
    assert (after[seen] - before[seen]).abs()[:, :3].mean() < 3 / 255
    first, last = ((x[~seen] - prior.target[~seen]).square().mean() for x in (before, after))
    assert last < 0.2 * first
    assert float(prior.loss(avatar, static_look(avatar))) == pytest.approx(
        float((after - prior.target).square().mean(1)[~seen].sum()) / len(views), rel=1e-4
    )


@pytest.mark.parametrize("views", [0.0, 50.0])
def test_an_avatar_of_which_all_or_nothing_was_seen_is_not_changed(scene, views):
    before = scene.avatar.features.clone()
    assert fill(scene.avatar, some(np.full(len(scene.avatar.surface), views)), HEAD) is None
    assert torch.equal(before, scene.avatar.features)


def test_a_body_without_a_head_has_a_prior_too(scene):
    views = np.where(scene.avatar.surface.points[:, 0] > 0, 50.0, 0.0)
    assert fill(scene.avatar, some(views), None) is not None


def test_a_prior_comes_back_from_a_checkpoint(scene):
    prior = fill(scene.avatar, some(np.where(scene.avatar.surface.points[:, 0] > 0, 50.0, 0.0)), HEAD)
    again = type(prior)(**prior.state())
    assert all(torch.equal(getattr(prior, f.name), getattr(again, f.name)) for f in dataclasses.fields(prior))
