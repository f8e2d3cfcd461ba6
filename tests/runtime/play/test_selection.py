"""The player picks a stored tier by the closeness or the speed that was measured."""

from __future__ import annotations

import types

import pytest

from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.play.selection import choose_tier

MEASURED = [
    {"name": "full", "frame_ms": 400.0, "worst_psnr_capture": 100.0, "psnr_capture": 100.0},
    {"name": "blendshape", "frame_ms": 9.0, "worst_psnr_capture": 38.0, "psnr_capture": 41.0},
    {"name": "baked", "frame_ms": 6.0, "worst_psnr_capture": 30.0, "psnr_capture": 33.0},
]


def bundle(tiers):
    """What is asked of a bundle."""
    manifest = types.SimpleNamespace(tiers=tiers, dynamic=True, members={})
    return types.SimpleNamespace(manifest=manifest, path="a.gavatar")


@pytest.mark.parametrize(
    ("asked", "tier"),
    [
        ({}, "full"),
        ({"tier": "baked"}, "baked"),
        ({"min_psnr": 35.0}, "blendshape"),
        ({"min_psnr": 99.0}, "full"),
        ({"target_fps": 30.0}, "blendshape"),
        ({"target_fps": 150.0}, "baked"),
        # the rate of a video is a wish: the closest that reaches it, else the fastest
        ({"wished_fps": 2.0}, "full"),
        ({"wished_fps": 30.0}, "blendshape"),
        ({"wished_fps": 1000.0}, "baked"),
        ({"wished_fps": 150.0, "min_psnr": 35.0}, "blendshape"),
        ({"wished_fps": 24.0, "target_fps": 150.0}, "baked"),
        ({"wished_fps": 150.0, "tier": "full"}, "full"),
    ],
)
def test_a_tier_is_picked_by_closeness_or_speed(asked, tier):
    assert choose_tier(bundle(MEASURED), **asked) == tier


def test_what_no_tier_can_do_and_what_excludes_each_other_is_refused():
    with pytest.raises(UserError, match="the fastest is blendshape at 111"):
        choose_tier(bundle(MEASURED), target_fps=150.0, min_psnr=35.0)
    with pytest.raises(WrongValue, match=r"`tier` .* one or the other"):
        choose_tier(bundle(MEASURED), tier="baked", min_psnr=35.0)


@pytest.mark.parametrize("tiers", [[], [{"name": "full"}], ["full", None]])
def test_a_bundle_without_figures_plays_in_full_and_refuses_to_choose(tiers):
    assert choose_tier(bundle(tiers), wished_fps=30.0) == "full"
    with pytest.raises(UserError, match=r"a\.gavatar holds no measured tiers .*--tiers auto"):
        choose_tier(bundle(tiers), min_psnr=35.0)
