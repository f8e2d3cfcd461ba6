"""Training: deterministic, resumable to the same result, and checked before any work starts."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from stopped_runs import stopped_after
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import check, compose_config
from gavatar.storage import load_tensors
from gavatar.training.motion_table import MotionTable, RowAdam
from gavatar.training.run import open_run, train
from gavatar.training.schedule import background_at, batch_rows, level_at, lr_factor
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.motion import Motion


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny")


def run(capture, out, *overrides):
    return train(compose_config([f"capture={capture}", f"out={out}", *SMALL, *overrides]), out)


@pytest.fixture(scope="module")
def trained(capture, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "whole"
    run(capture, out)
    return out


def assert_same(a: dict, b: dict):
    assert a.keys() == b.keys()
    for key, value in a.items():
        assert torch.equal(value, b[key]), key


def test_a_run_leaves_what_it_promises(trained):
    names = {p.name for p in trained.iterdir()}
    assert {"config.yaml", "checkpoint.pt", "stage1.pt", "stage2.pt", "motion.npz", "metrics.json", "previews"} <= names
    metrics = json.loads((trained / "metrics.json").read_text())
    assert metrics["finished"]
    assert {e["stage"] for e in metrics["history"]} == {1, 2}
    assert len(list((trained / "previews").glob("*.png"))) >= 3
    assert not list(trained.rglob(".*"))  # no temporary file is left


def test_training_lowers_the_loss(capture, tmp_path):
    # every view in every step over one background, so that first and last loss are of the same images
    same = [
        "background=white",
        "stage1.batch=6",
        "stage1.levels=[{until:1.0,gaussians:2850,image:0.25}]",
        "stage2.steps=0",
    ]
    trainer = run(capture, tmp_path / "r", *same, "stage1.steps=60", "stage1.lr_decoder=0.01")
    losses = [e["losses"]["l1"] for e in trainer.record.history]
    assert losses[-1] < 0.7 * losses[0]


def test_the_same_seed_gives_the_same_avatar_and_another_another(capture, trained, tmp_path):
    run(capture, tmp_path / "again")
    first = load_tensors(trained / "stage2.pt")
    assert_same(first["avatar"], load_tensors(tmp_path / "again" / "stage2.pt")["avatar"])
    run(capture, tmp_path / "other", "seed=1")
    assert not torch.equal(
        first["avatar"]["features"], load_tensors(tmp_path / "other/stage2.pt")["avatar"]["features"]
    )


@pytest.mark.parametrize("after", [("stage1", 2), ("stage1", 4), ("stage2", 2)])
def test_a_run_stopped_after_any_checkpoint_resumes_to_the_same_result(capture, trained, tmp_path, after):
    out = tmp_path / "stopped"
    with stopped_after(after):
        run(capture, out)
    run(capture, out)
    for stage in ("stage1.pt", "stage2.pt"):
        expected, got = load_tensors(trained / stage), load_tensors(out / stage)
        assert_same(expected["avatar"], got["avatar"])
        assert_same(expected["motion"], got["motion"])
    histories = [json.loads((d / "metrics.json").read_text())["history"] for d in (trained, out)]
    assert histories[0] == histories[1]


def test_a_run_killed_without_warning_resumes_to_the_same_result(capture, trained, tmp_path):
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "gavatar.cli.train", f"capture={capture}", f"out={out}", *SMALL]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 120
    while not (out / "checkpoint.pt").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert (out / "checkpoint.pt").exists(), process.stderr.read().decode()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert_same(load_tensors(trained / "stage2.pt")["avatar"], load_tensors(out / "stage2.pt")["avatar"])


def test_stage_two_starts_exactly_at_the_avatar_of_stage_one(capture, tmp_path):
    trainer = run(capture, tmp_path / "r", "stage2.steps=0")
    avatar = trainer.scene.avatar.eval()
    features = trainer.scene.pose_features(trainer.scene.frames[:2])
    assert features.abs().max() == 0
    still, posed = avatar.attributes(), avatar.attributes(features)
    assert torch.equal(still.offsets[0], posed.offsets[0])


def test_stage_two_freezes_features_and_motion_and_sees_the_refined_poses(trained):
    one, two = load_tensors(trained / "stage1.pt"), load_tensors(trained / "stage2.pt")
    assert torch.equal(one["avatar"]["features"], two["avatar"]["features"])
    assert_same(one["motion"], two["motion"])
    assert one["motion"]["rotation_correction"].abs().max() > 0
    assert any(not torch.equal(one["avatar"][k], two["avatar"][k]) for k in one["avatar"] if k.startswith("encoder"))
    with np.load(trained / "motion.npz") as file:
        assert set(file) >= {"poses", "trans", "betas", "mocap_framerate"}


# everything trained at once: the maps of light and joints, the features, the poses
LINEAR = [
    *(o for o in SMALL if not o.startswith("encoder")), "encoder=linear", "encoder.map_size=64",
    "stage2.lr_features=1e-2", "motion.stage2=1",
    "motion.stage2_trans=1", "motion.guard=false",
]  # fmt: skip


@pytest.fixture(scope="module")
def trained_wholly(capture, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "wholly"
    train(compose_config([f"capture={capture}", f"out={out}", *LINEAR]), out)
    return out


def test_stage_two_moves_features_and_poses_where_asked_to(trained_wholly):
    one, two = load_tensors(trained_wholly / "stage1.pt"), load_tensors(trained_wholly / "stage2.pt")
    assert (one["avatar"]["features"] - two["avatar"]["features"]).abs().max() > 1e-3
    assert two["avatar"]["encoder.maps"].abs().max() > 1e-3
    moved = (one["motion"]["rotation_correction"] - two["motion"]["rotation_correction"]).abs().amax((1, 2))
    assert moved[:6].min() > 0  # four steps of two views see every training frame at least once
    assert not moved[6:].any()
    opened = open_run(trained_wholly)
    assert torch.equal(opened.motion.rotation_correction, two["motion"]["rotation_correction"])
    with np.load(trained_wholly / "motion.npz") as file:
        np.testing.assert_array_equal(file["poses"], opened.motion.motion().poses.reshape(len(file["poses"]), -1))


@pytest.mark.parametrize("after", [("stage1", 6), ("stage2", 2)])
def test_poses_that_move_in_stage_two_resume_to_the_same_result(capture, trained_wholly, tmp_path, after):
    """Stage 2 goes on with stage 1's optimiser of the poses: a run stopped between the two must find it again."""
    config = compose_config([f"capture={capture}", f"out={tmp_path}", *LINEAR])
    with stopped_after(after):
        train(config, tmp_path)
    train(config, tmp_path)
    expected, got = load_tensors(trained_wholly / "stage2.pt"), load_tensors(tmp_path / "stage2.pt")
    assert_same(expected["avatar"], got["avatar"])
    assert_same(expected["motion"], got["motion"])


def test_poses_do_not_jump_when_stage_two_begins(capture, tmp_path):
    """What Adam knows of a pose's gradients is carried over; begun anew, a first step has full length everywhere."""
    settings = [*LINEAR, "stage1.steps=40", "stage2.steps=1", "stage2.batch=6"]
    train(compose_config([f"capture={capture}", f"out={tmp_path}", *settings]), tmp_path)
    one, two = load_tensors(tmp_path / "stage1.pt")["motion"], load_tensors(tmp_path / "stage2.pt")["motion"]
    step = (one["rotation_correction"] - two["rotation_correction"])[:6].abs()
    assert 0 < step.mean() < 0.5 * 1e-2  # the rate, which a first step of Adam reaches whatever the gradient


def test_the_baseline_leaves_the_motion_alone_and_frames_outside_training_are_never_moved(capture, tmp_path):
    run(capture, tmp_path / "moved", "motion.guard=false", "stage2.steps=0")
    table = load_tensors(tmp_path / "moved/stage1.pt")["motion"]["rotation_correction"]
    assert table[:6].abs().amax((1, 2)).min() > 0
    assert table[6:].abs().max() == 0
    run(capture, tmp_path / "r", "motion.enabled=false", "stage2.steps=0")
    assert load_tensors(tmp_path / "r/stage1.pt")["motion"]["rotation_correction"].abs().max() == 0


def test_a_static_avatar_has_one_stage(capture, tmp_path):
    settings = [o for o in SMALL if not o.startswith("encoder")]
    train(compose_config([f"capture={capture}", f"out={tmp_path / 'r'}", *settings, "encoder=none"]), tmp_path / "r")
    assert not (tmp_path / "r/stage2.pt").exists()
    assert open_run(tmp_path / "r").avatar.encoder is None


def test_a_directory_with_another_run_is_refused_and_overwrite_starts_afresh(capture, trained, tmp_path):
    with pytest.raises(UserError, match=r"another seed.*overwrite=true"):
        run(capture, trained, "seed=5")
    run(capture, tmp_path / "r", "stage2.steps=0")
    run(capture, tmp_path / "r", "stage2.steps=0", "seed=3", "overwrite=true")
    assert open_run(tmp_path / "r").config.seed == 3


def test_a_damaged_checkpoint_is_one_sentence(capture, trained, tmp_path):
    run(capture, tmp_path / "r", "stage2.steps=0")
    (tmp_path / "r/checkpoint.pt").write_bytes(b"PK garbage")
    with pytest.raises(UserError, match=r"checkpoint\.pt is not a readable checkpoint"):
        run(capture, tmp_path / "r", "stage2.steps=0")
    with pytest.raises(UserError, match="not a run directory"):
        open_run(tmp_path)


def test_poses_move_and_their_losses_are_asked_only_within_the_motion_window(capture, tmp_path):
    options = ["stage2.steps=0", "stage1.steps=12", "motion.guard=false", "losses.motion_prior=1.0"]
    for window, moves, asked in (((1.0, 1.0), False, (False, False)), ((0.5, 1.0), True, (False, True))):
        start, end = window
        trainer = run(capture, tmp_path / f"{start}", *options, f"motion.start={start}", f"motion.end={end}")
        assert bool(trainer.scene.motion.rotation_correction.any()) == moves
        assert tuple("motion_prior" in trainer.record.history[i]["losses"] for i in (0, -1)) == asked
    assert trainer.record.history[-1]["step"] == 11


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace("guard:", "gard:"), "gard"),
        (lambda text: text.replace("checkpoint_every", "capture_every").replace("motion:", "notion:"), "motion"),
        (lambda text: text.replace("sharing_end: ", "sharing_end: -"), "sharing_end must be"),
        (lambda text: "model: {a: [", "not the configuration of a run"),
        (lambda text: "7", "not the configuration of a run"),
    ],
)
def test_a_configuration_that_cannot_be_read_is_one_sentence_naming_it(trained, tmp_path, capture, change, words):
    shutil.copytree(trained, tmp_path / "run")
    path = tmp_path / "run" / "config.yaml"
    path.write_text(change(path.read_text()))
    for act in (lambda: open_run(tmp_path / "run"), lambda: run(capture, tmp_path / "run")):
        with pytest.raises(UserError, match=words) as error:
            act()
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)


def test_a_configuration_of_another_size_than_what_was_trained_is_one_sentence(trained, tmp_path):
    shutil.copytree(trained, tmp_path / "run")
    path = tmp_path / "run" / "config.yaml"
    path.write_text(path.read_text().replace("\n  features: ", "\n  features: 1"))
    with pytest.raises(UserError, match=r"stage2\.pt does not fit config\.yaml.*size mismatch") as error:
        open_run(tmp_path / "run")
    assert "\n" not in str(error.value)


def test_training_on_one_frame_works(tmp_path):
    capture = write_tiny_capture(tmp_path / "one", frames=(20,), test=(), novel=())
    trainer = run(capture, tmp_path / "r")
    assert np.isfinite([e["losses"]["total"] for e in trainer.record.history]).all()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("background=blue", "background must be"),
        ("stage1.levels=[{until:0.5,gaussians:2850,image:1.0}]", "rise to 1.0"),
        ("stage1.levels=[{until:1.0,gaussians:2850,image:0}]", "image must be within"),
        ("stage2.levels=[{until:1.0,uv:32,image:1.0}]", r"stage2\.levels: uv 32 is not possible: .*from 64 to 1024"),
        ("stage1.levels=[{until:1.0,uv:2048,image:1.0}]", r"stage1\.levels: uv 2048 is not possible"),
        ("stage1.levels=[{until:1.0,gaussians:0}]", r"stage1\.levels: gaussians 0 is not possible: .*1 to 1,000,000"),
        ("stage1.levels=[{until:1.0,gaussians:9,uv:64}]", "either 'gaussians', their number, or 'uv'"),
        ("stage1.levels=[{until:1.0,image:1.0}]", "either 'gaussians', their number, or 'uv'"),
        ("stage1.batch=0", "batch at least 1"),
        ("motion.start=0.9", "start <= end"),
        ("losses.l1=-1", "l1"),
        ("+losses.l2=1", r"unknown loss 'l2'.*did you mean 'l1'"),
    ],
)
def test_a_wrong_setting_is_found_before_any_work(override, message):
    extra = ["motion.end=0.1"] if "motion.start" in override else []
    with pytest.raises(UserError, match=message):
        check(compose_config(["capture=anything", override, *extra]))


def test_the_schedule_is_a_function_of_the_step_alone():
    config = check(compose_config(["capture=x", "experiment=demo"])).stage1
    assert level_at(config, 0) == config.levels[0]
    assert level_at(config, config.steps - 1) == config.levels[-1]
    assert lr_factor(config, 0) == 1
    assert lr_factor(config, config.steps - 1) == pytest.approx(config.lr_final)
    seen = [row for step in range(7) for row in batch_rows(3, 10, 4, step)]
    assert all(len(set(batch_rows(3, 10, 4, step))) == 4 for step in range(50))
    assert sorted(set(seen)) == list(range(10))
    assert batch_rows(0, 1, 4, 5) == [0]
    assert not torch.equal(background_at("random", 0, 1), background_at("random", 0, 2))
    assert (background_at("white", 0, 1) == 1).all()


def test_row_adam_is_adam_on_the_rows_it_is_given():
    start = torch.randn(5, 3, generator=torch.Generator().manual_seed(0))
    ours, theirs = torch.nn.Parameter(start.clone()), torch.nn.Parameter(start[[1, 3]].clone())
    row_adam = RowAdam([ours], lr=0.1, betas=(0.9, 0.99), eps=1e-8)
    adam = torch.optim.Adam([theirs], lr=0.1, betas=(0.9, 0.99), eps=1e-8)
    for _ in range(5):
        ours.grad = ours.detach() ** 3
        theirs.grad = theirs.detach() ** 3
        row_adam.step(torch.tensor([1, 3]))
        adam.step()
    # the same sums in another order: a few float32 roundings over five steps
    assert torch.allclose(ours[[1, 3]], theirs, atol=1e-6)
    assert torch.equal(ours[[0, 2, 4]], start[[0, 2, 4]])


def test_corrections_do_not_wrap_where_the_estimate_jumps_by_a_full_turn():
    poses = np.zeros((2, 22, 3), np.float32)
    poses[0, 0, 1], poses[1, 0, 1] = np.pi, -np.pi  # one and the same rotation
    table = MotionTable(Motion(poses, np.zeros((2, 3), np.float32), 15.0), 52)
    rotations = table().rotations
    assert torch.allclose(rotations[0], rotations[1], atol=1e-6)
    assert table.motion().poses.shape == (2, 52, 3)
