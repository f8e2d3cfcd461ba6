"""What training keeps: refined poses that render better, dynamics that pay."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import check, compose_config
from gavatar.storage import load_tensors
from gavatar.training.remedies.acceptance import dynamics_verdict, refuse_worse_poses
from gavatar.training.remedies.judging import detail_of
from gavatar.training.run import open_run, train
from gavatar.training.scene import Scene
from gavatar.training.stage import REFUSED
from gavatar.training.trainer import Trainer
from gavatar.training.verdicts import DynamicsVerdict, Look, Verdicts
from gavatar_runtime.errors import UserError


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


def run(capture, out, *overrides):
    return train(compose_config([f"capture={capture}", f"out={out}", *SMALL, *overrides]), out)


def test_a_frame_whose_pose_got_worse_is_given_its_estimate_back(capture, tmp_path):
    scene = run(capture, tmp_path, "stage1.steps=30", "stage2.steps=0", "motion.guard=false").scene
    table = scene.motion
    before = table.rotation_correction.detach().clone()
    with torch.no_grad():
        table.rotation_correction[2, 0] = torch.tensor([0.0, 0.0, 1.5])  # lies on its side
    refused = refuse_worse_poses(scene, 0.25)
    assert 2 in refused
    after = table.rotation_correction
    assert not after[2].any()
    assert not table.trans_correction[2].any()
    kept = [frame for frame in scene.frames if frame not in refused]
    assert torch.equal(after[kept], before[kept])
    # what is left can only be better than, or as good as, the estimate
    rows = list(range(len(scene.views)))
    estimated = scene.errors(rows, 0.25, poses=lambda frame: table.estimated([frame]))
    assert (scene.errors(rows, 0.25) <= estimated).all()


def test_the_guard_reports_the_frames_it_refused(capture, tmp_path):
    run(capture, tmp_path, "stage2.steps=0", "motion.lr=1.5", "losses.motion_prior=0", "losses.motion_smoothness=0")
    refused = json.loads((tmp_path / "metrics.json").read_text())["verdicts"]["frames_kept_as_estimated"]
    opened = open_run(tmp_path)
    assert refused
    assert not opened.motion.rotation_correction[refused].any()


def test_dynamics_that_do_not_pay_leave_a_static_avatar(capture, tmp_path, monkeypatch):
    trainer = run(capture, tmp_path, "dynamics=auto", "dynamics_gain=50")
    verdict = trainer.record.verdicts.dynamics
    assert not verdict.kept
    assert verdict.views == 1
    assert (tmp_path / REFUSED).exists()
    assert not (tmp_path / "stage2.pt").exists()
    assert open_run(tmp_path).avatar.encoder is None
    # the same command again: what was judged is not judged anew
    monkeypatch.setattr(Scene, "errors", lambda *a, **k: pytest.fail("judged again"))
    assert run(capture, tmp_path, "dynamics=auto", "dynamics_gain=50").record.verdicts.dynamics == verdict
    assert not (tmp_path / "stage2.pt").exists()


def test_both_looks_are_judged_by_images_of_one_size(capture, tmp_path):
    """An avatar that stage 2 does not change gains nothing, whatever the sizes of the stages' images."""
    sizes = [
        "stage1.levels=[{until:1.0,gaussians:2850,image:0.5}]",
        "stage2.levels=[{until:1.0,gaussians:2850,image:0.125}]",
    ]
    still = ["stage2.lr_decoder=0", "stage2.lr_encoder=0", "motion.guard=false"]
    verdict = run(capture, tmp_path, "dynamics=auto", *sizes, *still).record.verdicts.dynamics
    assert verdict.gain_db == pytest.approx(0, abs=1e-3)


LEVELS = "stage2.levels=[{until:0.5,gaussians:2000,image:0.125},{until:1.0,gaussians:2850,image:0.25}]"


def test_dynamics_that_lose_on_the_views_that_judge_are_spared_the_last_level(capture, tmp_path, monkeypatch):
    losing = [LEVELS, "dynamics=auto", "stage1.steps=30", "stage2.steps=8", "stage2.lr_encoder=1.0"]
    trainer = run(capture, tmp_path, *losing)
    verdict = trainer.record.verdicts.dynamics
    assert verdict.gain_db < 0
    assert not verdict.kept
    assert [entry["step"] for entry in trainer.record.history if entry["stage"] == 2] == [0]  # the last would be told
    assert json.loads((tmp_path / "metrics.json").read_text())["gaussians"] == 2850
    assert len(open_run(tmp_path).avatar.surface) == 2850
    assert load_tensors(tmp_path / "checkpoint.pt")["step"] == 8
    monkeypatch.setattr(Scene, "errors", lambda *a, **k: pytest.fail("judged again"))
    assert run(capture, tmp_path, *losing).record.verdicts.dynamics == verdict


def test_dynamics_that_do_not_lose_go_on_to_the_last_level(capture, tmp_path):
    still = [LEVELS, "dynamics=auto", "stage2.lr_decoder=0", "stage2.lr_encoder=0", "motion.guard=false"]
    trainer = run(capture, tmp_path, "stage2.steps=8", *still)
    assert [entry["step"] for entry in trainer.record.history if entry["stage"] == 2] == [0, 7]


def test_dynamics_that_do_not_pay_give_the_poses_of_stage_1_back(capture, tmp_path):
    moving = ["motion.stage2=1", "motion.stage2_trans=3", "stage2.lr_features=1e-2"]
    trainer = run(capture, tmp_path, "dynamics=auto", "dynamics_gain=50", *moving)
    refused, kept = load_tensors(tmp_path / REFUSED)["motion"], load_tensors(tmp_path / "stage1.pt")["motion"]
    assert not torch.equal(refused["trans_correction"], kept["trans_correction"])
    assert torch.equal(trainer.scene.motion.trans_correction, kept["trans_correction"])
    with np.load(tmp_path / "motion.npz") as file:
        np.testing.assert_array_equal(file["trans"], open_run(tmp_path).motion.motion().trans)


@pytest.mark.parametrize("moving", ["motion.stage2=1", "motion.stage2_trans=1"])
def test_rotations_and_translations_move_apart_in_stage_2(capture, tmp_path, moving):
    run(capture, tmp_path, moving, "motion.guard=false")
    one, two = (load_tensors(tmp_path / f"stage{n}.pt")["motion"] for n in (1, 2))
    turned, shifted = (not torch.equal(one[key], two[key]) for key in ("rotation_correction", "trans_correction"))
    assert (turned, shifted) == (moving == "motion.stage2=1", moving == "motion.stage2_trans=1")


def test_stage_2_never_sees_the_views_that_judge_it(capture, tmp_path, monkeypatch):
    overrides = [f"capture={capture}", f"out={tmp_path}", *SMALL, "dynamics=auto", "stage2.steps=12"]
    trainer = Trainer(check(compose_config(overrides)), tmp_path)
    trainer.stage(1).run(None)
    stage, learnt = trainer.stage(2), set()
    draw = stage._draw

    def watched(rows, *arguments):
        learnt.update(rows)
        return draw(rows, *arguments)

    monkeypatch.setattr(stage, "_draw", watched)
    stage.run(None)
    assert learnt == {0, 1, 3, 4, 5}


def look_of(errors, distances=None, detail=1e-3) -> Look:
    return Look(list(errors), distances, detail)


@pytest.mark.parametrize(
    ("ratio", "kept"),
    [([0.5, 0.5, 0.5], True), ([1.0, 1.0, 1.0], False), ([2.0, 2.0, 2.0], False), ([0.4, 2.0, 0.9, 0.6], False),
     ([0.5], False)],
)  # fmt: skip
def test_dynamics_are_kept_for_a_gain_beyond_chance(ratio, kept):
    static = np.full(len(ratio), 1e-3)
    assert dynamics_verdict(look_of(static), look_of(static * ratio), 0.1).kept is kept


@pytest.mark.parametrize(
    ("dynamic", "against"),
    [
        (look_of([8e-4, 8e-4, 1.9e-3], [0.1, 0.1, 0.1]), []),
        (look_of([5e-4, 5e-4, 2.1e-3], [0.1, 0.1, 0.1]), ["the worst view is worse"]),
        (look_of([8e-4, 8e-4, 1.6e-3], [0.1, 0.1, 0.12]), ["it looks less alike"]),
        (look_of([8e-4, 8e-4, 1.6e-3], [0.1, 0.1, 0.1], 0.9e-3), ["detail is lost"]),
        (look_of([1e-3, 1e-3, 2e-3], [0.1, 0.1, 0.1]), ["no gain", "a gain that may be chance"]),
    ],
)
def test_everything_must_speak_for_dynamics(dynamic, against):
    static = look_of([1e-3, 1e-3, 2e-3], [0.1, 0.1, 0.1])
    verdict = dynamics_verdict(static, dynamic, 0.1)
    assert [text for text in against if text not in verdict.against] == []
    assert verdict.kept is not against or not against
    assert all(text in verdict.sentence() for text in against)


def test_equal_images_do_not_break_the_verdict():
    same = look_of([0.0] * 4, [0.0] * 4, 0.0)
    verdict = dynamics_verdict(same, same, 0.1)
    assert (verdict.kept, verdict.gain_db, verdict.standard_error_db, verdict.views) == (False, 0.0, 0.0, 4)
    assert verdict.detail_ratio is None


def test_verdicts_of_earlier_versions_are_read():
    former = {"static_errors": [0.1], "dynamics": {"kept": True, "gain_db": 1.0, "standard_error_db": None, "views": 1}}
    assert Verdicts.from_json(former).dynamics == DynamicsVerdict(True, 1.0, None, 1)
    assert Verdicts.from_json(former).as_json()["dynamics"]["kept"] is True


def test_detail_is_what_is_finer_than_a_few_pixels_on_the_person():
    checks = (torch.arange(32)[:, None] + torch.arange(32)) % 2
    image, everywhere = checks.float().expand(1, 3, 32, 32), torch.ones(1, 32, 32)
    assert detail_of(image, everywhere) > 0.2
    assert detail_of(torch.full((1, 3, 32, 32), 0.3), everywhere) < 1e-9
    alpha = torch.zeros(1, 32, 32)
    assert detail_of(image, alpha) == 0
    alpha[:, 8:24, 8:24] = 1
    outline = alpha[:, None].expand(1, 3, 32, 32)
    assert detail_of(outline, alpha) < 1e-9  # an outline is no detail


def test_the_numbers_of_a_judged_run_stand_in_its_metrics(capture, tmp_path):
    run(capture, tmp_path, "dynamics=auto", "dynamics_gain=-50", "stage2.lr_decoder=0")
    verdicts = json.loads((tmp_path / "metrics.json").read_text())["verdicts"]
    assert verdicts["dynamics"]["detail_ratio"] == pytest.approx(1, abs=0.5)
    assert verdicts["dynamics"]["worst_gain_db"] is not None
    assert 0 <= verdicts["residual"]["fine_rms"] < 0.1
    assert 0 <= verdicts["residual"]["beyond"] <= 1


def test_encoder_auto_is_the_linear_one_on_trial(capture):
    config = check(compose_config([f"capture={capture}", "out=x", "encoder=auto"]))
    assert config.dynamics == "auto"
    assert config.encoder["name"] == "linear"


@pytest.mark.parametrize("option", ["dynamics=sometimes", "dynamics_gain=nan"])
def test_impossible_options_are_refused(capture, option):
    with pytest.raises(UserError, match="dynamics"):
        check(compose_config([f"capture={capture}", "out=x", option]))


@pytest.mark.parametrize("dynamics", ["always", "auto"])
def test_a_finished_run_given_again_stays_as_it_is(capture, tmp_path, dynamics):
    run(capture, tmp_path, f"dynamics={dynamics}", "dynamics_gain=-50")
    before = json.loads((tmp_path / "metrics.json").read_text())
    assert before["gaussians"] > 0
    run(capture, tmp_path, f"dynamics={dynamics}", "dynamics_gain=-50")
    after = json.loads((tmp_path / "metrics.json").read_text())
    assert {k: after[k] for k in ("gaussians", "history", "verdicts")} == {
        k: before[k] for k in ("gaussians", "history", "verdicts")
    }
