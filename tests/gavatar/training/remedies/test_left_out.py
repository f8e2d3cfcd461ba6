"""Which views judge dynamics, and how new the poses of views are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gavatar.training.newness import LEAST, MOST, draw_shares, newness
from gavatar.training.remedies.left_out import LARGEST, left_out_rows
from gavatar.training.schedule import batch_rows


def places_of(*clusters: tuple[int, float]) -> torch.Tensor:
    """(V, 2) so many poses at each place, a little apart."""
    rows = [np.full(count, place) + 1e-3 * np.arange(count) for count, place in clusters]
    return torch.from_numpy(np.stack([np.concatenate(rows), np.zeros(sum(map(len, rows)))], 1))


def test_whole_stretches_and_a_whole_cluster_of_poses_are_left_out():
    places = places_of((60, 0.0), (7, 50.0), (53, 9.0))
    frames = list(range(10, 130))
    out = left_out_rows(places, frames)
    assert set(range(60, 67)) <= set(out)  # the cluster: all of it
    others = [row for row in out if row not in range(60, 67)]
    gaps = np.flatnonzero(np.diff(others) > 1)
    assert len(gaps) == 1  # two stretches without a gap
    assert len(others) == 2 * 6
    assert out == sorted(out)


def test_a_frame_is_left_out_in_all_its_views():
    frames = [frame for frame in range(40) for _ in range(3)]
    out = left_out_rows(torch.randn(120, 5, generator=torch.Generator().manual_seed(0), dtype=torch.float64), frames)
    held = {frames[row] for row in out}
    assert out == [row for row in range(120) if frames[row] in held]


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 6, 15, 16, 17, 100, 1000])
def test_most_views_stay_whatever_their_number(count):
    out = left_out_rows(torch.zeros(count, 3, dtype=torch.float64), list(range(count)))
    assert bool(out) == (count >= 4)
    assert len(out) <= count / 2


def test_the_cluster_is_not_larger_than_what_may_be_spared():
    places = places_of((50, 0.0), (50, 50.0))
    assert len(left_out_rows(places, list(range(100)))) <= 2 * 5 + LARGEST * 100


def test_a_pose_that_recurs_is_new_once():
    new = newness(places_of((400, 0.0), (1, 50.0), (20, 100.0)))
    assert float(new.sum()) == pytest.approx(3, rel=0.1)  # the poses of a cluster lie a little apart
    assert float(new[400]) == pytest.approx(1)
    shares = draw_shares(new)
    assert shares.mean() == pytest.approx(1)
    assert 10 < shares[400] / shares[0] <= MOST / LEAST  # by its newness, but not beyond these


def test_poses_that_are_all_alike_or_all_apart_are_drawn_alike():
    for places in (torch.zeros(7, 3, dtype=torch.float64), 100 * torch.eye(7, dtype=torch.float64)):
        np.testing.assert_allclose(draw_shares(newness(places)), 1)


def test_views_are_drawn_by_their_share_and_alike_after_a_restart():
    shares = np.array([0.25, 0.25, 0.5, 1.0, 2.0, 0.5, 0.5])
    shares *= 7 / shares.sum()
    steps = [batch_rows(3, 7, 2, step, shares) for step in range(1400)]
    assert all(len(set(rows)) == 2 for rows in steps)
    drawn = np.bincount(np.concatenate(steps), minlength=7) / 400  # epochs of 7
    # a row comes once a batch at most, so that the one with the largest share loses some of it to the others
    assert (drawn[:4] >= shares[:4]).all()
    assert 0.6 * shares[4] < drawn[4] < shares[4]
    assert drawn.argmax() == 4
    assert [batch_rows(3, 7, 2, step, shares) for step in range(700, 710)] == steps[700:710]


def test_equal_shares_show_each_view_once_an_epoch():
    for epoch in range(5):
        rows = [row for step in range(epoch * 4, epoch * 4 + 4) for row in batch_rows(0, 12, 3, step, np.ones(12))]
        assert sorted(rows) == list(range(12))
