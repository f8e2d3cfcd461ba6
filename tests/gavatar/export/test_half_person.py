"""Limbs that a capture never shows are not part of its bundle, but what was seen of them is."""

from types import SimpleNamespace

import numpy as np
import pytest
from surfaces import free_surface

from gavatar.export.half_person import never_filmed
from gavatar.training.remedies.placed_evidence import PlacedEvidence
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.values.point_evidence import FULL, Evidence

SURFACE = free_surface(64)
LEGS = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "ankle", "foot"))


def run_of(resting, views=None):
    """What is asked of a run: its points, its body, its capture and what its views say of each point."""
    evidence = None
    if views is not None:
        whole = np.zeros(len(SURFACE), np.int32)
        evidence = PlacedEvidence(SURFACE.points, Evidence(views, views, 0 * views, whole, whole))
    return SimpleNamespace(
        avatar=SimpleNamespace(surface=SURFACE),
        capture=SimpleNamespace(resting=resting),
        built=SimpleNamespace(body=SimpleNamespace(data=load_free_body())),
        evidence=evidence,
    )


def test_legs_that_were_never_filmed_are_hidden_and_nothing_else():
    hidden = never_filmed(run_of(LEGS))
    height = SURFACE.points[:, 1]
    hips = SURFACE.joints[[1, 2], 1].mean()
    assert hidden[height < hips - 0.15].all()  # metres: below the groin there are legs alone
    assert not hidden[height > hips + 0.1].any()
    assert not never_filmed(run_of(())).any()


@pytest.mark.parametrize("seen", [0.0, FULL])
def test_what_was_seen_of_a_limb_stays(seen):
    views = np.zeros(len(SURFACE), np.float32)
    thighs = SURFACE.points[:, 1] > SURFACE.joints[[4, 5], 1].mean() + 0.1  # metres above the knees
    views[thighs] = seen
    hidden = never_filmed(run_of(LEGS, views))
    assert hidden[~thighs & (SURFACE.points[:, 1] < 0.2 + SURFACE.points[:, 1].min())].all()
    assert hidden[thighs].any() == (seen == 0)


def test_fingers_go_with_a_wrist_that_was_never_seen():
    hidden = never_filmed(run_of(("left_wrist",)))
    names = list(load_free_body().joint_names)
    tips = [names.index(name) for name in ("left_index3", "right_index3")]
    left, right = (((SURFACE.joint_index == tip) & (SURFACE.joint_weight > 0.9)).any(1) for tip in tips)
    assert left.any()
    assert hidden[left].all()
    assert not hidden[right].any()


def test_a_shin_beyond_a_knee_that_was_never_seen_cannot_have_been_seen():
    hidden = never_filmed(run_of(LEGS, np.full(len(SURFACE), 2 * FULL, np.float32)))
    middle = 0.5 * (SURFACE.joints[[4, 5], 1].mean() + SURFACE.joints[[7, 8], 1].mean())
    assert hidden[SURFACE.points[:, 1] < middle].all()
    assert not hidden[SURFACE.points[:, 1] > SURFACE.joints[[4, 5], 1].mean() + 0.1].any()
