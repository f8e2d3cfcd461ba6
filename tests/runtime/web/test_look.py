"""What of an avatar a page draws, and what it cannot."""

from __future__ import annotations

import numpy as np
import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import WrongValue
from gavatar_runtime.web.look import read_look

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from tiered_members import COUNT, write_tiered


@pytest.fixture(scope="module")
def tiered(tmp_path_factory) -> Avatar:
    return Avatar(read_bundle(write_tiered(tmp_path_factory.mktemp("look") / "t.gavatar")), tier=None)


def test_the_best_tier_that_a_page_can_play_is_taken(tiered):
    look = read_look(tiered)
    assert look.tier == "blendshape"
    assert look.residual is not None
    assert len(look) == COUNT
    assert read_look(tiered, "baked").residual is None


@pytest.mark.parametrize("tier", ["full", "int8", "coarse", "nonsense"])
def test_other_tiers_are_refused_with_those_there_are(tiered, tier):
    with pytest.raises(WrongValue, match=f"tier={tier}.*blendshape or baked"):
        read_look(tiered, tier)


def test_a_moving_look_without_either_says_how_to_export_it(dynamic):
    with pytest.raises(WrongValue, match="--tiers baked,blendshape"):
        read_look(Avatar(read_bundle(dynamic), tier=None))


def test_an_avatar_of_one_look_needs_no_tier(static):
    body = Avatar(read_bundle(static), tier=None)
    look = read_look(body)
    drawn = Avatar(read_bundle(static)).gaussians(look.relaxed)
    assert look.residual is None
    assert len(look) == len(drawn)
    assert np.abs(look.colors - drawn.colors).max() < 1e-6


def test_thinned_keeps_as_many_and_each_is_wider(static):
    look = read_look(Avatar(read_bundle(static), tier=None))
    fewer = look.thinned(100)
    assert len(fewer) == 100
    assert np.all(fewer.scales > look.scales.min())
    assert np.isfinite(fewer.scales).all()
    assert look.thinned(len(look)) is look
    assert look.thinned(10**9) is look
    assert len(look.thinned(1)) == 1
    with pytest.raises(WrongValue, match="from 1 up"):
        look.thinned(0)
