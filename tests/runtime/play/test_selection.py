"""Which stored tier is played."""

from __future__ import annotations

import argparse
import dataclasses

import pytest

from gavatar_runtime.errors import UserError
from gavatar_runtime.play.selection import choose_tier


def arguments(**values):
    return argparse.Namespace(
        **{"tier": None, "min_psnr": None, "target_fps": None, "fps": None, "reuse": 1, "seen_only": False} | values
    )


def test_the_player_picks_a_tier_by_closeness_or_speed(tiered_bundle):
    described = [
        {"name": "full", "frame_ms": 400.0, "worst_psnr_capture": 100.0, "psnr_capture": 100.0},
        {"name": "blendshape", "frame_ms": 9.0, "worst_psnr_capture": 38.0, "psnr_capture": 41.0},
        {"name": "baked", "frame_ms": 6.0, "worst_psnr_capture": 30.0, "psnr_capture": 33.0},
    ]
    made = dataclasses.replace(tiered_bundle.manifest, tiers=described)
    fake = type("Fake", (), {"manifest": made, "path": "a.gavatar"})()
    assert choose_tier(fake, arguments()) == "full"
    assert choose_tier(fake, arguments(tier="baked")) == "baked"
    assert choose_tier(fake, arguments(min_psnr=35.0)) == "blendshape"
    assert choose_tier(fake, arguments(min_psnr=99.0)) == "full"
    assert choose_tier(fake, arguments(target_fps=30.0)) == "blendshape"
    assert choose_tier(fake, arguments(target_fps=150.0)) == "baked"
    with pytest.raises(UserError, match="the fastest is blendshape at 111"):
        choose_tier(fake, arguments(target_fps=150.0, min_psnr=35.0))
    with pytest.raises(UserError, match="one or the other"):
        choose_tier(fake, arguments(tier="baked", min_psnr=35.0))
    # the rate of a video is a wish: the closest that reaches it, else the fastest
    assert choose_tier(fake, arguments(fps=2.0)) == "full"
    assert choose_tier(fake, arguments(fps=30.0)) == "blendshape"
    assert choose_tier(fake, arguments(fps=1000.0)) == "baked"
    assert choose_tier(fake, arguments(fps=150.0, min_psnr=35.0)) == "blendshape"
    assert choose_tier(fake, arguments(fps=24.0, target_fps=150.0)) == "baked"
    assert choose_tier(fake, arguments(fps=150.0, tier="full")) == "full"
    assert choose_tier(fake, arguments(fps=150.0, reuse=2)) == choose_tier(fake, arguments(fps=9.0, seen_only=True))
    fake.manifest = dataclasses.replace(made, tiers=[])
    assert choose_tier(fake, arguments(fps=30.0)) == "full"  # a bundle of one tier plays as it is
    with pytest.raises(UserError, match="holds no measured tiers"):
        choose_tier(fake, arguments(min_psnr=35.0))
