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


MAIN = SURFACE.joint_index[:, 0]  # the joint that each point hangs on most
THIGHS, SHINS = np.isin(MAIN, [1, 2]), np.isin(MAIN, [4, 5])
SURE = SURFACE.joint_weight[:, 0] > 0.6


def test_legs_that_were_never_filmed_are_hidden_and_nothing_else():
    hidden = never_filmed(run_of(LEGS))
    assert hidden[SURE & (THIGHS | SHINS)].all()
    assert not hidden[SURE & ~np.isin(MAIN, [1, 2, 4, 5, 7, 8, 10, 11])].any()
    assert not never_filmed(run_of(())).any()


@pytest.mark.parametrize("seen", [0.0, FULL])
def test_what_was_seen_of_a_thigh_stays_but_not_of_a_shin_whose_knee_was_never_seen(seen):
    hidden = never_filmed(run_of(LEGS, np.full(len(SURFACE), seen, np.float32)))
    assert hidden[SURE & SHINS].all()
    assert (hidden[SURE & THIGHS] == (seen == 0)).all()


def test_fingers_go_with_a_wrist_that_was_never_seen():
    hidden = never_filmed(run_of(("left_wrist",)))
    names = list(load_free_body().joint_names)
    tips = [names.index(name) for name in ("left_index3", "right_index3")]
    left, right = (((SURFACE.joint_index == tip) & (SURFACE.joint_weight > 0.9)).any(1) for tip in tips)
    assert left.any()
    assert hidden[left].all()
    assert not hidden[right].any()
