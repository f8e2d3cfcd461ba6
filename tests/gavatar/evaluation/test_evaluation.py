"""Evaluation: what is scored with which poses, and the commands on a trained run."""

from __future__ import annotations

import dataclasses
import importlib
import json
import subprocess
import sys

import numpy as np
import pytest
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import compose_config
from gavatar.evaluation.dynamics import weigh_dynamics
from gavatar.evaluation.evaluation_figure import evaluation_figure
from gavatar.evaluation.result import DynamicsWorth
from gavatar.evaluation.scores import Evaluator, evaluate
from gavatar.training.run import open_run, train
from gavatar_runtime.errors import UserError


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    capture = write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")
    out = tmp_path_factory.mktemp("run") / "run"
    train(compose_config([f"capture={capture}", f"out={out}", *SMALL]), out)
    return open_run(out)


@pytest.fixture(scope="module")
def result(run):
    return evaluate(run, fit_steps=3, progress=False)


def test_every_row_says_which_poses_were_rendered(result):
    rows = {(r.split, r.poses): len(r.scores) for r in result.rows}
    assert rows == {
        ("train", "refined"): 6, ("test", "true"): 1, ("test", "fitted"): 1, ("novel_pose", "true"): 1,
        ("novel_pose", "fitted"): 1,
    }  # fmt: skip


def test_the_split_that_was_trained_is_rendered_with_refined_poses(tmp_path):
    capture = write_tiny_capture(tmp_path / "tiny")
    settings = [f"capture={capture}", f"out={tmp_path / 'run'}", *SMALL, "stage2.steps=0", "train_split=test"]
    train(compose_config(settings), tmp_path / "run")
    found = evaluate(open_run(tmp_path / "run"), fit_steps=0, perceptual=False, progress=False)
    assert {(r.split, r.poses) for r in found.rows} == {("train", "true"), ("test", "refined"), ("novel_pose", "true")}


def test_true_poses_have_no_joint_error_and_others_have(result):
    assert result.row("test", "true").mpjpe_mm < 1e-3
    assert 20 < result.estimated_mpjpe_mm[0] < 120  # the capture's stated 52 mm, over six frames
    assert result.row("train", "refined").mpjpe_mm != pytest.approx(result.estimated_mpjpe_mm[0])


def test_the_table_and_the_files_state_the_protocol(result, tmp_path):
    text = str(result)
    assert "not LPIPS" in text
    assert "fitted: poses were fitted" in text
    result.write(tmp_path / "e.json")
    written = json.loads((tmp_path / "e.json").read_text())
    assert written["rows"][0]["worst_view"].startswith("cam0/")
    assert np.isfinite([row["psnr"] for row in written["rows"]]).all()
    evaluation_figure(result, tmp_path / "e.png")
    assert (tmp_path / "e.png").stat().st_size > 10_000


def test_fitting_held_out_poses_lowers_the_image_error(run):
    evaluator = Evaluator(run, progress=False)
    views = run.capture.views("test")
    before = evaluator.score("test", "estimated", views, run.capture.motion).psnr
    after = evaluator.score("test", "fitted", views, evaluator.fit(views, steps=25)).psnr
    assert after > before


def test_dynamics_are_weighed_on_held_out_frames(run, result):
    worth = weigh_dynamics(result)
    assert (worth.splits, worth.poses, worth.views) == (["test", "novel_pose"], "true", 2)
    static = evaluate(open_run(run.directory, stage=1), fit_steps=0, perceptual=False, progress=False)
    gains = [result.row(s, "true").psnr - static.row(s, "true").psnr for s in worth.splits]  # one view each
    assert worth.gain_db == pytest.approx(np.mean(gains), abs=2e-3)  # rounded to 0.001 dB
    assert worth.cost_ms > 0
    assert worth.worth == (not worth.against)
    assert (worth.gain_db < 0.1) == ("no gain" in worth.against)
    assert worth.detail_ratio > 0
    assert f"{worth.gain_db:+.2f} dB" in worth.sentence()
    result.dynamics = worth
    assert result.as_json()["dynamics"]["views"] == 2
    result.dynamics = None
    assert weigh_dynamics(static) is None
    only_trained = evaluate(run, splits=["train"], fit_steps=0, perceptual=False, progress=False)
    assert weigh_dynamics(only_trained) is None


@pytest.mark.parametrize("against", [[], ["detail is lost"]])
def test_the_verdict_on_dynamics_says_what_to_do(against):
    worth = DynamicsWorth(["test"], "true", 40, 0.5, 0.04, 0.2, 0.9, 0.98, 0.1, 21.4, not against, against)
    text = worth.sentence()
    assert "21 ms a frame" in text
    assert "98 % of the detail" in text
    assert ("not worth (detail is lost) their cost" in text) == bool(against)
    assert ("gavatar-export --stage 1" in text) == bool(against)
    one = dataclasses.replace(worth, views=1, standard_error_db=None, perceptual_ratio=None).sentence()
    assert "standard error" not in one
    assert "perceptual" not in one


def test_an_unknown_split_names_those_there_are(run):
    with pytest.raises(UserError, match="no split 'valid'"):
        evaluate(run, splits=["valid"], perceptual=False, progress=False)


def call(module: str, *arguments) -> subprocess.CompletedProcess:
    code = f"from gavatar.cli.{module} import main; main({[str(a) for a in arguments]!r})"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)


def test_the_commands_run_on_a_trained_run(run, tmp_path):
    done = call("evaluate", run.directory, "--no-fit", "--splits", "test", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "PSNR" in done.stdout
    assert "dynamics gain" in done.stdout
    assert (tmp_path / "evaluation.json").exists()
    done = call("export", run.directory, "-o", tmp_path / "t.gavatar", "--stage", 1)
    assert done.returncode == 0, done.stderr
    assert "verified on 6 poses" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["export", "nowhere"], "nowhere is not a run directory"),
        (["evaluate", "nowhere"], "nowhere is not a run directory"),
        (["train", "capture=nowhere"], "nowhere is not a directory"),
        (["train"], "gavatar-train"),
        (["train", "capture=x", "decoder=mpl"], "did you mean 'mlp'?"),
        (["train", "capture=x", "stage1.steps=many"], "many"),
        (["train", "capture=x", "decodr=mlp"], "decodr"),
        (["demo", "quick"], "KEY=VALUE"),
    ],
)
def test_mistakes_are_one_sentence_and_exit_code_two(arguments, words, monkeypatch, tmp_path, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", list(sys.argv))  # which gavatar-train sets for Hydra, as it does the variable
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    command = importlib.import_module(f"gavatar.cli.{arguments[0]}")
    with pytest.raises(SystemExit) as end:
        command.main(arguments[1:])
    printed = capfd.readouterr()
    assert words in printed.err + printed.out
    if len(arguments) > 1:
        assert end.value.code == 2
        assert printed.err.startswith("error: ")
        assert len(printed.err.strip().splitlines()) == 1
    assert list(tmp_path.rglob("*.pt")) == []


def test_multirun_trains_each_choice_in_its_own_directory(tmp_path):
    capture = write_tiny_capture(tmp_path / "tiny", frames=(0, 20), test=(), novel=())
    settings = [o for o in SMALL if not o.startswith("decoder")]
    out = tmp_path / "sweep"
    arguments = [f"capture={capture}", f"out={out}", *settings, "--multirun", "decoder=mlp,upstream"]
    done = call("train", *arguments)
    assert done.returncode == 0, done.stderr
    finished = sorted(p.parent.name for p in out.rglob("stage2.pt"))
    assert len(finished) == 2
    assert "decoder=mlp" in finished[0]
    assert "decoder=upstream" in finished[1]
