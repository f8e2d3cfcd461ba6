"""Frames whose estimate is plainly wrong are put right from their neighbours; the others are left alone."""

from __future__ import annotations

import importlib.util
import json

import numpy as np
import pytest
import torch
from places import ROOT
from stopped_runs import stopped_after
from tiny_capture import SMALL, write_tiny_capture

from gavatar.body.torch_rotations import matrix_from_axis_angle, rotation_vector_from_matrix
from gavatar.config import check, compose_config
from gavatar.storage import load_tensors
from gavatar.training.motion_table import MotionTable, RowAdam
from gavatar.training.remedies.outliers import between, exchanged, mend_outliers, other_side
from gavatar.training.run import train
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.skeletons import BODY

FRAMES = tuple(range(80, 92))  # an arm is raised
JUMPED, UNEVEN = 2, 8


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Successive frames on their true poses, but for one whose root jumps 20 cm."""
    folder = write_tiny_capture(tmp_path_factory.mktemp("capture") / "tiny", frames=FRAMES, test=(40,), novel=(105,))
    with np.load(folder / "body_truth.npz") as truth, np.load(folder / "body.npz") as given:
        arrays = dict(given) | {key: truth[key].copy() for key in ("poses", "trans")}
    arrays["trans"][JUMPED, 0] += 0.2
    np.savez(folder / "body.npz", **arrays)
    return folder


def run(capture, out, *overrides):
    settings = [o for o in SMALL if not o.startswith("encoder")]
    settings += ["encoder=none", "stage1.steps=60", "stage1.batch=4", "stage1.lr_decoder=0.01", "motion.guard=false"]
    settings += ["stage1.levels=[{until:1.0,gaussians:2850,image:0.25}]", *overrides]
    return train(compose_config([f"capture={capture}", f"out={out}", *settings]), out)


def off_by(trainer):
    """(T,) metres between each training frame's root and the truth."""
    return np.linalg.norm(trainer.scene.motion.motion().trans - trainer.capture.truth.trans, axis=-1)[: len(FRAMES)]


def test_a_jump_is_mended_and_the_frames_around_it_are_not_touched(capture, tmp_path):
    trainer = run(capture, tmp_path, "motion.mend=0.7", "motion.start=0.7")
    assert trainer.record.verdicts.frames_mended == [JUMPED]
    assert json.loads((tmp_path / "metrics.json").read_text())["verdicts"]["frames_mended"] == [JUMPED]
    assert off_by(trainer)[JUMPED] < 0.03


def test_the_end_of_the_stage_is_a_time_to_mend(capture, tmp_path):
    verdicts = run(capture, tmp_path, "motion.mend=1", "stage1.steps=2").record.verdicts
    assert verdicts.frames_mended is not None


def test_without_mending_the_jump_stays(capture, tmp_path):
    assert off_by(run(capture, tmp_path, "motion.mend=0"))[JUMPED] > 0.1


def test_a_run_stopped_after_mending_resumes_to_the_same_result(capture, tmp_path):
    settings = ("motion.mend=0.7", "checkpoint_every=50")
    run(capture, tmp_path / "whole", *settings)

    with stopped_after():
        run(capture, tmp_path / "stopped", *settings)
    run(capture, tmp_path / "stopped", *settings)
    whole, stopped = (load_tensors(tmp_path / name / "stage1.pt")["motion"] for name in ("whole", "stopped"))
    for key in whole:
        assert torch.equal(whole[key], stopped[key]), key


def test_exchanged_limbs_are_recognised(capture, tmp_path):
    scene = run(capture, tmp_path, "motion.enabled=false").scene
    table, names = scene.motion, list(scene.built.body.data.joint_names)
    true = table.initial_rotations[UNEVEN].clone()
    table.initial_rotations[UNEVEN] = exchanged(true, names)
    assert UNEVEN in mend_outliers(scene, 0.25)["exchanged"]
    # a rotation and its inverse in float32
    assert torch.allclose(table([UNEVEN]).rotations[0], true, atol=1e-5)


def table_of(poses, trans, fps=10.0):
    return MotionTable(Motion(np.float32(poses), np.float32(trans), fps), poses.shape[1])


def test_a_steady_motion_is_its_own_interpolation():
    times = np.arange(6) / 10
    poses = np.zeros((6, 22, 3))
    poses[:, 1, 1] = 3 * times + 2.5  # across pi
    trans = np.stack([times, 0 * times, 2 * times], -1)
    found = between(table_of(poses, trans), [0, 1, 3, 5], 0.0)
    assert sorted(found) == [1, 3]  # ends have no neighbour on one side
    for frame, pose in found.items():
        expected = matrix_from_axis_angle(torch.as_tensor(poses[frame], dtype=torch.float32))
        # float32 rotation vectors near pi
        assert torch.allclose(pose.rotations[0], expected, atol=1e-5)
        assert torch.allclose(pose.trans[0], torch.as_tensor(trans[frame], dtype=torch.float32), atol=1e-6)


@pytest.mark.parametrize(("count", "reach"), [(1, 0.0), (2, 0.0), (5, 10.0)])
def test_without_neighbours_there_is_nothing_between(count, reach):
    assert between(table_of(np.zeros((count, 22, 3)), np.zeros((count, 3))), list(range(count)), reach) == {}


def test_exchanging_twice_is_nothing_and_a_mirror_mirrors():
    vectors = torch.randn(2, len(BODY), 3, generator=torch.Generator().manual_seed(0))
    rotations = matrix_from_axis_angle(vectors)
    names = list(BODY)
    assert torch.allclose(exchanged(exchanged(rotations, names), names), rotations, atol=1e-6)
    once = rotation_vector_from_matrix(exchanged(rotations, names))
    left, right = names.index("left_elbow"), names.index("right_elbow")
    assert torch.allclose(matrix_from_axis_angle(once)[:, left], matrix_from_axis_angle(
        vectors[:, right] * torch.tensor([1.0, -1, -1])), atol=1e-5)  # fmt: skip
    assert torch.equal(exchanged(rotations, names)[:, 0], rotations[:, 0])
    there = ("left_hip", "right_hip", "spine1", "left_wing")
    assert [other_side(name, there) for name in there] == ["right_hip", "left_hip", "spine1", "left_wing"]


def test_forgotten_rows_start_afresh():
    p = torch.nn.Parameter(torch.zeros(3, 2))
    adam = RowAdam([p], lr=0.1)
    for _ in range(3):
        p.grad = torch.ones_like(p)
        adam.step(torch.tensor([0, 1]))
    adam.forget([1])
    assert adam.state[p]["count"].tolist() == [3, 0, 0]
    assert not adam.state[p]["first"][1].any()
    assert adam.state[p]["first"][0].all()


@pytest.mark.parametrize("value", [-0.1, 1.5, "nan"])
def test_an_impossible_time_to_mend_is_named(value):
    with pytest.raises(UserError, match=r"motion\.mend must be a fraction of the stage"):
        check(compose_config(["capture=x", f"motion.mend={value}"]))


def test_planted_errors_are_dealt_once_each():
    path = ROOT / "benchmarks" / "bad_frames.py"
    spec = importlib.util.spec_from_file_location("bad_frames", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    frames = list(range(0, 240, 2))
    groups = module.dealt(frames, 0)
    assert sorted(f for group in groups.values() for f in group) == frames
    assert {name: len(group) for name, group in groups.items()} == {"turned": 12, "swapped": 2, "jump": 4, "none": 102}
    arrays = {"poses": np.zeros((240, 156), np.float32), "trans": np.zeros((240, 3), np.float32)}
    spoilt = module.spoilt(arrays, groups, 0)
    angles = np.linalg.norm(spoilt["poses"].reshape(240, 52, 3), axis=-1)
    assert np.allclose(angles[groups["turned"]].sum(1), 4 * np.pi / 6, atol=1e-4)
    assert not angles[groups["none"]].any()
    assert spoilt["trans"][groups["jump"]].tolist() == [[pytest.approx(0.2), 0, 0]] * 4
