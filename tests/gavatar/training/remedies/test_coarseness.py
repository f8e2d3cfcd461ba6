"""What of a change on the body is finer than 5 cm."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from make_bundle import free_body

from gavatar.avatar.atlas import sample_atlas
from gavatar.losses import LossComposer, LossInputs
from gavatar.training.remedies.coarseness import NEXT, RADIUS, FinePart, ToNeighbours, surroundings


@pytest.fixture(scope="module")
def surface(tmp_path_factory):
    return sample_atlas(free_body(), None, 128, cache_dir=tmp_path_factory.mktemp("surfaces"))


def rms(values: torch.Tensor) -> float:
    return float(values.square().mean().sqrt())


def test_surroundings_lie_within_the_radius_and_are_drawn_alike_each_time(surface):
    chosen, near = surroundings(surface.points, 3, count=500)
    assert len(set(chosen.tolist())) == 500
    distance = np.linalg.norm(surface.points[near] - surface.points[chosen][:, None], axis=-1)
    assert distance.max() <= RADIUS
    again = surroundings(surface.points, 3, count=500)
    assert torch.equal(again[0], chosen)
    assert torch.equal(again[1], near)


def test_what_varies_over_the_body_is_coarse_and_what_varies_from_point_to_point_is_fine(surface):
    points = torch.from_numpy(surface.points)
    slow = torch.sin(points * 2 * np.pi / 1.0)[None]  # a metre from crest to crest
    quick = torch.sin(points * 2 * np.pi / 0.02)[None]
    fine = FinePart()
    assert rms(fine(slow, surface)) < 0.12 * rms(slow)  # 2 pi 5 cm / 1 m is 0.3: a third of that over a ball
    assert rms(fine(quick, surface)) > 0.9 * rms(quick)
    assert not fine(torch.ones(2, len(surface), 3), surface).abs().max() > 1e-6


def test_few_points_and_none():
    points = np.array([[0.0, 0, 0], [1.0, 0, 0]], np.float32)
    chosen, near = surroundings(points, 0)
    assert near.tolist() == [[i] * near.shape[1] for i in chosen.tolist()]  # nobody else is near
    chosen, near = surroundings(points[:0], 0)
    assert chosen.shape == (0,)


def test_the_loss_is_the_mean_square_and_abstains_without_an_encoder():
    image = torch.zeros(1, 3, 8, 8)
    inputs = LossInputs(render=image, target=image, alpha=image[:, 0], mask=image[:, 0])
    composer = LossComposer({"pose_detail": 2.0})
    assert composer(inputs)[1] == {}
    inputs.pose_detail = torch.full((1, 4, 3), 0.5)
    total, values = composer(inputs)
    assert values == {"pose_detail": pytest.approx(0.25)}
    assert float(total) == pytest.approx(0.5)


def test_neighbours_are_the_nearest_points_one_after_another(surface):
    points = torch.from_numpy(surface.points)
    apart = ToNeighbours()
    steps = [apart(points[None], surface, step)[0].norm(dim=1) for step in range(NEXT)]
    assert all((a <= b + 1e-6).all() for a, b in itertools.pairwise(steps))
    assert (steps[-1] > 0).all()  # some texels of an atlas share a place
    assert torch.equal(apart(points[None], surface, NEXT)[0].norm(dim=1), steps[0])


@pytest.mark.parametrize("count", [1, 2, 4])
def test_few_points_have_few_neighbours(surface, count):
    few = surface.take(np.arange(count))
    got = ToNeighbours()(torch.arange(float(count))[None, :, None], few, 1)
    assert got is None if count == 1 else (got != 0).all()


def test_roughness_is_the_mean_difference_and_abstains_where_the_look_stands_still():
    image = torch.zeros(1, 3, 8, 8)
    inputs = LossInputs(render=image, target=image, alpha=image[:, 0], mask=image[:, 0])
    composer = LossComposer({"roughness": {"weight": 2.0, "offset": 0.5, "scale": 0.25}})
    assert composer(inputs)[1] == {}
    inputs.to_neighbours = torch.cat([torch.full((1, 4, n), v) for n, v in ((3, -0.5), (3, 2.0), (1, -4.0))], 2)
    total, values = composer(inputs)
    assert values == {"roughness": pytest.approx(0.5 + 0.5 * 2.0 + 0.25 * 4.0)}
    assert float(total) == pytest.approx(2 * 2.5)
