"""What the two stages do is a value, and what they found out is another."""

from __future__ import annotations

import dataclasses
import json

import pytest

from gavatar.config import check, compose_config
from gavatar.training.plan import Plan, stage_plans
from gavatar.training.schedule import lr_factor
from gavatar.training.verdicts import (
    Choice,
    DynamicsVerdict,
    FillingVerdict,
    Look,
    ResidualVerdict,
    ShapeVerdict,
    Verdicts,
)


def plans(*overrides, dynamic: bool = True) -> list[Plan]:
    return stage_plans(check(compose_config(["capture=x", "out=x", "experiment=demo", *overrides])), dynamic)


def test_appearance_and_motion_come_first_dynamics_second():
    one, two = plans("stage2.lr_features=0", "motion.stage2=0", "motion.stage2_trans=0", "seed=3")
    assert (one.number, two.number) == (1, 2)
    assert (one.seed, two.seed) == (4, 5)  # each draws views and backgrounds of its own
    assert (one.dynamic, two.dynamic) == (False, True)
    assert (one.learns_features, two.learns_features) == (True, False)
    assert (one.poses_move, two.poses_move) == (True, False)
    assert one.static_level == two.static_level == one.stage.levels[-1]


@pytest.mark.parametrize(("overrides", "dynamic"), [([], False), (["stage2.steps=0"], True)])
def test_an_avatar_without_dynamics_has_one_stage(overrides, dynamic):
    assert [plan.number for plan in plans(*overrides, dynamic=dynamic)] == [1]


def test_poses_move_within_the_window_of_stage_1_and_all_through_stage_2():
    one, two = plans("motion.start=0.25", "motion.end=0.5", "motion.stage2=0.5", "motion.stage2_trans=0")
    progress = (0.0, 0.25, 0.5, 0.75, 1.0)
    assert [one.poses_move_at(p) for p in progress] == [False, True, True, False, False]
    assert all(two.poses_move_at(p) for p in progress)
    assert two.pose_rates == (0.5 * two.motion.lr, 0)
    still = plans("motion.enabled=false")
    assert not any(plan.poses_move_at(p) for plan in still for p in progress)


def test_frames_share_less_and_less_in_stage_1_and_least_in_stage_2():
    given = ["motion.sharing=0.8", "motion.sharing_final=0.2", "motion.sharing_end=0.5"]
    one, two = plans(*given)
    assert [one.sharing(p, 100.0) for p in (0.0, 0.25, 1.0)] == pytest.approx([0.8, 0.5, 0.2])
    assert [two.sharing(p, 100.0) for p in (0.0, 1.0)] == pytest.approx([0.2, 0.2])


def test_only_stage_2_knows_the_pose_encoder_and_moves_places_faster():
    one, two = plans("motion.sharing_end=0.5", "motion.sharing_final=0", "stage1.steps=100")
    assert (one.dynamic, two.dynamic) == (False, True)
    assert one.pose_rates == (one.motion.lr, one.motion.lr_trans)
    assert two.pose_rates == (one.motion.lr, 3 * one.motion.lr_trans)
    assert one.sharing(0.5, 100.0) == 0
    factors = [lr_factor(one.stage, step) for step in range(100)]
    assert factors[0] == 1
    assert factors == sorted(factors, reverse=True)
    assert factors[99] == pytest.approx(one.stage.lr_final)


def test_texture_stays_still_in_stage_2():
    _, two = plans()
    assert (two.learns_features, two.learns_decoder) == (False, False)
    _, published = plans("experiment=paper")
    assert (published.learns_features, published.learns_decoder, published.draws_new) == (False, True, False)


@pytest.mark.parametrize(
    ("mend", "steps", "expected"),
    [(0.0, 10, None), (0.5, 10, 5), (1.0, 10, 9), (1.0, 1, 0), (0.01, 10, 0)],
)
def test_outliers_are_mended_before_a_step_that_there_is(mend, steps, expected):
    assert plans(f"motion.mend={mend}", f"stage1.steps={steps}")[0].mend_step == expected


def test_another_shape_is_tried_of_an_avatar_that_is_one():
    steps = [plans("motion.betas=auto", f"stage1.steps={n}")[0].shape_step for n in (10, 199, 200, 1000)]
    assert steps == [None, None, 50, 100]
    assert plans("motion.betas=true")[0].shape_step is None


def test_brightness_is_told_before_a_step_that_there_is():
    assert [plans(f"stage1.steps={n}")[0].exposure_step for n in (1, 5, 1000)] == [0, 0, 100]
    assert plans("exposure=false")[0].exposure_step is None


def test_what_needs_moving_poses_rests_where_they_do():
    (one, *_) = plans("motion.enabled=false", "motion.mend=0.5", "motion.betas=true")
    assert (one.mend_step, one.learns_shape) == (None, False)


@pytest.mark.parametrize(("dynamics", "least"), [("auto", 0.25), ("always", None)])
def test_dynamics_are_judged_in_stage_2_where_asked_to(dynamics, least):
    one, two = plans(f"dynamics={dynamics}", "dynamics_gain=0.25")
    assert (one.least_gain, two.least_gain) == (None, least)


WHOLE = Verdicts(
    betas=ShapeVerdict([0.0, 1.0], [0.5, 1.0]),
    static_look=Look([0.25], None, 0.01),
    residual=ResidualVerdict(0.005, 0.01),
    dynamics=DynamicsVerdict(False, -0.5, None, 1, -0.1, None, 0.9, ["no gain"]),
    frames_mended=[],
    frames_kept_as_estimated=[3],
    frames_kept_as_estimated_stage2=[],
    unseen=FillingVerdict(5, 9, 0),
    choices={"mask_matte": Choice(5.0, 3.02, "too wide"), "exposure": Choice(False, None, "")},
)


@pytest.mark.parametrize("verdicts", [Verdicts(), Verdicts(frames_mended=[]), WHOLE])
def test_verdicts_come_back_from_json_as_they_were(verdicts):
    assert Verdicts.from_json(json.loads(json.dumps(verdicts.as_json()))) == verdicts


def test_json_holds_what_was_decided_alone():
    assert Verdicts().as_json() == {}
    assert Verdicts(frames_mended=[]).as_json() == {"frames_mended": []}  # asked, and nothing found
    assert set(WHOLE.as_json()) == {field.name for field in dataclasses.fields(Verdicts)}
    known = {"kept": False, "gain_db": -0.5, "standard_error_db": None, "views": 1, "worst_gain_db": -0.1}
    known |= {"perceptual_ratio": None, "detail_ratio": 0.9, "against": ["no gain"]}
    assert WHOLE.as_json()["dynamics"] == known
