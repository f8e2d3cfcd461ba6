"""The ladder of ways to play an avatar."""

from __future__ import annotations

import json

import numpy as np

from gavatar.measure.choices import Choice, default_choices
from gavatar.measure.fidelity import Likeness, compare, images
from gavatar.measure.ladder import dominated, run_ladder
from gavatar.measure.ladder_report import table
from gavatar_runtime import native_library
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import frame_motion
from gavatar_runtime.values.motion import Motion


def test_every_rung_of_the_ladder_opens_and_is_named_once(fine_bundle):
    choices = default_choices(fine_bundle, enough=3000)
    assert len({c.label for c in choices}) == len(choices)
    assert {"baked, backface 0.3", "full, seen only", "blendshape, 3000 Gaussians", "baked, resolution 0.5"} <= {
        c.label for c in choices
    }
    for choice in choices:
        choice.open(fine_bundle)
        choice.renderer(fine_bundle)


def test_only_what_is_beaten_in_both_is_dominated():
    assert dominated([1, 9, 8], [100, 40, 39]) == [False, False, True]
    assert dominated([9, 9], [40, 40]) == [False, False]  # alike in all
    assert dominated([9, 9], [40, 39]) == [False, True]
    assert dominated([], []) == []


def test_images_of_a_choice_compared_with_themselves_are_equal(tiered_bundle):
    motion = Motion(np.zeros((2, 52, 3), np.float32), np.zeros((2, 3), np.float32), 30.0)
    camera = frame_motion(Avatar(tiered_bundle, tier="baked"), motion, 48, 48)
    drawn = images(Choice("baked"), tiered_bundle, motion, [0, 1], [camera, camera])
    assert compare(drawn, drawn) == Likeness(100.0, 100.0, None)


def test_a_ladder_says_of_each_choice_what_it_costs_and_how_close_it_comes(tiered_bundle, tiered_run):
    motion = Avatar(tiered_bundle, tier=None).fit(read_motion("wave"))[0].taken(slice(12))
    choices = [Choice("full"), Choice("baked"), Choice("full", reuse=2), Choice("baked", switches={"fast": True})]
    if not native_library.available()[0]:
        choices.pop()
    rows = run_ladder(tiered_bundle.path, motion, 32, 48, capture=tiered_run.capture, choices=choices, processes=False)
    assert [row.choice for row in rows] == choices
    assert all(0 < row.speed.median_ms < np.inf and row.speed.frames > 0 for row in rows)
    assert rows[0].full == Likeness(100.0, 100.0)
    assert rows[1].full.worst_psnr <= rows[1].full.psnr < 100
    assert rows[1].bundle_mb < rows[0].bundle_mb
    assert all(5 < row.footage.psnr < 100 for row in rows)
    values = json.loads(json.dumps([row.as_json() for row in rows]))
    assert values[2]["label"] == "full, reuse 2"
    assert values[0]["psnr_vs_full"] == 100.0
    assert values[0]["memory_mb"] is None
    assert [v["fast"] for v in values if "fast" in v] in ([False, False, False, True], [])
    text = table(rows, "a machine", None)
    assert "32 x 48 pixels" in text
    assert all(choice.label in text for choice in choices)
