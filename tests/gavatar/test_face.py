"""gavatar from Python: the face's functions, and that importing it costs nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from tiny_capture import SMALL, write_tiny_capture

import gavatar
from gavatar.cli.evaluate import main as evaluate_command
from gavatar.config import check, compose_config
from gavatar.training.trainer import resolved
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.notes import Note

STATIC = {
    "progress": False, "threads": 1, "encoder": "none", "losses": "demo", "preview_every": 100, "dynamics": "always",
    "decoder": {"widths": [32, 32], "skip": 1, "head_width": 16}, "avatar": {"features": 8, "feature_size": 64},
    "stage1": {"steps": 3, "batch": 2, "levels": [{"until": 1.0, "uv": 64, "image": 0.25}]},
}  # fmt: skip


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


@pytest.fixture(scope="module")
def run(capture, tmp_path_factory):
    return gavatar.train(capture, out=tmp_path_factory.mktemp("run") / "static", **STATIC)


def python(script: str, *options: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, *options, "-c", script], capture_output=True, text=True)


def test_importing_it_loads_neither_torch_nor_numpy():
    done = python("import sys, gavatar; print({'torch', 'hydra', 'cv2', 'numpy'} & set(sys.modules), dir(gavatar))")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("set()")
    for name in gavatar.__all__:
        assert f"'{name}'" in done.stdout


def test_without_torch_one_sentence_names_the_extra():
    done = python(
        "import sys; sys.modules['torch'] = None\n"
        "import gavatar\n"
        "try: gavatar.train\n"
        "except gavatar.UserError as error: print(error)"
    )
    assert done.stdout.strip() == "gavatar.train needs torch, which is not installed: pip install 'gavatar[train]'"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'trian'"):
        gavatar.trian  # noqa: B018
    assert gavatar.prepare.__module__ == "gavatar.preparation.from_footage"  # a function, and no package of that name
    assert gavatar.__version__


def test_a_run_says_what_it_is(run, capture, tmp_path):
    assert (run.stage, run.dynamic, run.config.seed, run.capture.name) == (1, False, 0, "tiny")
    assert repr(run) == f"<TrainedRun {run.directory}: stage 1, {run.gaussians:,} Gaussians, static>"
    assert run.metrics["finished"]
    assert run.config.stage1.steps == 3
    again = gavatar.open_run(run.directory)
    assert (again.directory, again.stage, again.gaussians) == (run.directory, 1, run.gaussians)
    with pytest.raises(UserError, match="not a run directory"):
        gavatar.open_run(tmp_path)


def test_an_opened_capture_trains_as_its_folder_does(run, capture):
    opened = gavatar.open_capture(capture)
    assert opened.views("train")
    again = gavatar.train(opened, out=run.directory, **STATIC)
    assert again.metrics == run.metrics  # the same run, which was finished: no step was taken


def test_settings_give_what_the_command_line_composes(capture):
    from gavatar.overrides import as_overrides

    nested = {
        "encoder": {"name": "unet_small", "width": 8, "map_size": 64},
        "decoder": {"widths": [32, 32], "skip": 1, "head_width": 16},
        "avatar": {"features": 8, "feature_size": 64},
        "stage1": {"steps": 6, "batch": 2, "levels": [{"until": 0.5, "gaussians": 2000, "image": 0.125},
                                                      {"until": 1.0, "gaussians": 2850, "image": 0.25}]},
        "stage2": {"steps": 4, "batch": 2, "levels": [{"until": 1.0, "gaussians": 2850, "image": 0.25}],
                   "lr_features": 0},
        "progress": False, "threads": 1, "checkpoint_every": 2, "preview_every": 3, "losses": "demo",
        "dynamics": "always", "motion": {"stage2": 0, "stage2_trans": 0},
    }  # fmt: skip
    dotted = [f"capture={capture}", *SMALL]
    assert resolved(check(compose_config([f"capture={capture}", *as_overrides(nested)]))) == resolved(
        check(compose_config(dotted))
    )


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"stage1": {"stpes": 5}}, "unknown setting 'stage1.stpes'"),
        ({"stage1.stpes": 5}, "unknown setting 'stage1.stpes'"),
        ({"sead": 5}, "unknown setting 'sead': .*did you mean 'seed'"),
        ({"seed": "many"}, "could not be converted to Integer"),
        ({"seed": [1, 2]}, "seed"),
        ({"seed": object()}, "seed: a object is no setting"),
        ({"stage1": {"steps": -1}}, "stage1.steps must be at least 0"),
        ({"preset": "dmeo"}, "unknown experiment 'dmeo': .*did you mean 'demo'"),
        ({"encoder": "lienar"}, "unknown encoder 'lienar': .*did you mean 'linear'"),
        ({"encoder": {"name": "linear", "width": 5}}, "unknown setting 'encoder.width'|encoder"),
        ({"losses": "dmeo"}, "unknown losses 'dmeo': .*did you mean 'demo'"),
        ({"losses": {"l1": -1}}, "losses.l1.weight: must be a number at least 0"),
        ({"sta ge": 5}, "sta ge=5"),
    ],
)
def test_a_wrong_setting_is_one_sentence_before_any_work(capture, tmp_path, settings, sentence):
    with pytest.raises(UserError, match=sentence) as error:
        gavatar.train(capture, out=tmp_path / "run", **settings)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "run").exists()


def test_another_run_in_the_folder_is_refused_by_what_differs(run, capture):
    with pytest.raises(UserError, match=r"another seed \(0, now 5\), stage1.steps \(3, now 4\)"):
        gavatar.train(capture, out=run.directory, seed=5, **(STATIC | {"stage1": {**STATIC["stage1"], "steps": 4}}))


def test_evaluating_gives_rows_and_leaves_the_run_as_it_was(run, tmp_path, capsys):
    result = run.evaluate(["train"], fit_steps=0, perceptual=False, progress=False)
    assert [row.split for row in result.rows] == ["train"]
    assert np.isfinite(result.rows[0].psnr)
    with pytest.raises(UserError, match="unknown rasterizer"):
        run.evaluate(["train"], fit_steps=0, perceptual=False, progress=False, rasterizer="tiels")
    again = run.evaluate(["train"], fit_steps=0, perceptual=False, progress=False)
    assert again.rows[0].psnr == result.rows[0].psnr
    # the command is a client of it
    with pytest.raises(SystemExit) as done:
        evaluate_command(
            [str(run.directory), "--splits", "train", "--no-fit", "--no-perceptual", "--out", str(tmp_path)]
        )
    assert done.value.code == 0
    written = json.loads((tmp_path / "evaluation.json").read_text())
    assert written["rows"][0]["psnr"] == round(result.rows[0].psnr, 3)
    capsys.readouterr()


def test_exporting_writes_a_bundle_that_says_what_it_is(run, tmp_path):
    exported = run.export(tmp_path / "anna.gavatar", poses=2)
    assert os.fspath(exported) == str(tmp_path / "anna.gavatar")
    assert read_bundle(exported.path).manifest.gaussians == run.gaussians
    assert "verified on 2 poses: positions within" in str(exported)
    assert run.export(poses=2).path == run.directory / "tiny.gavatar"
    with pytest.raises(UserError, match=r"ends in \.gavatar"):
        run.export(tmp_path / "anna.zip")
    with pytest.raises(UserError, match=r"`poses=0`: give at least 1"):
        run.export(tmp_path / "other.gavatar", poses=0)
    assert not (tmp_path / "other.gavatar").exists()


def test_exporting_to_a_page_leaves_no_bundle(run, tmp_path):
    exported = run.export(tmp_path / "anna.html", poses=2)
    assert (tmp_path / "anna.html").read_text().startswith("<!DOCTYPE html>")
    assert exported.manifest.gaussians == run.gaussians
    assert [p.name for p in tmp_path.iterdir()] == ["anna.html"]


def test_a_page_holds_the_motions_that_it_is_given(run, tmp_path):
    run.export(tmp_path / "anna.html", poses=2, motions=["idle", "wave"])
    text = (tmp_path / "anna.html").read_text()
    assert text.index('"name":"idle"') < text.index('"name":"wave"')
    assert '"name":"turn"' not in text
    with pytest.raises(UserError, match="a bundle holds none"):
        run.export(tmp_path / "anna.gavatar", motions=["wave"])
    with pytest.raises(UserError, match="jmup"):
        run.export(tmp_path / "other.html", motions=["jmup"])
    assert [p.name for p in tmp_path.iterdir()] == ["anna.html"]


def test_an_export_at_another_resolution_changes_neither_the_run_nor_its_scores(run, tmp_path):
    before = run.evaluate(["train"], fit_steps=0, perceptual=False, progress=False).rows[0].psnr
    with pytest.warns(Note, match="`uv=96` is the former way to say `gaussians="):
        assert run.export(tmp_path / "finer.gavatar", uv=96, poses=2).manifest.gaussians > run.gaussians
    assert run.export(tmp_path / "fewer.gavatar", gaussians=700, poses=2).manifest.gaussians == 700
    assert run.evaluate(["train"], fit_steps=0, perceptual=False, progress=False).rows[0].psnr == before
