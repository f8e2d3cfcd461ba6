"""An avatar on SMPL-X's 55 joints: trained, exported and played, with hands and jaw that move."""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch
from smplx_capture import expressions, hand_motion, write_smplx_capture, write_smplx_model
from tiny_capture import SMALL, write_tiny_capture

from gavatar.assemble import build_body, capture_on_body
from gavatar.avatar.atlas import sample_atlas
from gavatar.avatar.blendshapes import expression_of
from gavatar.avatar.trainable import Pose
from gavatar.capture.opening import open_capture
from gavatar.capture.placement import Placement
from gavatar.config import compose_config
from gavatar.evaluation.joint_errors import motion_errors, part_errors
from gavatar.evaluation.scores import evaluate
from gavatar.export.bundling import export
from gavatar.registry import BODIES
from gavatar.storage import load_tensors
from gavatar.training.posing import posed
from gavatar.training.run import open_run, train
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.cli.play import main as play
from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.motion import Motion

FINGER = "left_index1"


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    return folder, write_smplx_model(folder)


@pytest.fixture(scope="module")
def capture(models, tmp_path_factory):
    return write_smplx_capture(tmp_path_factory.mktemp("capture") / "hands", models[1], face=True)


def trained(capture, folder, out, *overrides):
    settings = [f"capture={capture}", f"out={out}", *SMALL, *overrides]
    settings += [] if "body=free" in overrides else [f"body.path={folder}"]
    if "encoder=none" in overrides:
        settings = [s for s in settings if s == "encoder=none" or not s.startswith("encoder")]
    train(compose_config(settings), out)
    return open_run(out)


@pytest.fixture(scope="module")
def run(capture, models, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "run"
    return trained(capture, models[0], out, "motion.joints=55", "stage1.steps=12", "body.hands=mean")


@pytest.fixture(scope="module")
def bundle(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "hands.gavatar"
    export(run, path)
    return path


def points_of(avatar, joint: str, share: float = 0.7) -> np.ndarray:
    """Rows of the Gaussians that follow a joint by more than `share`."""
    j = avatar.joint_names.index(joint)
    return np.flatnonzero((avatar.surface.joint_weight * (avatar.surface.joint_index == j)).sum(1) > share)


def test_the_capture_chooses_the_body(run, models):
    assert run.built.body.data.name == "smplx"
    assert run.config.body == {"name": "smplx", "path": str(models[0]), "gender": "neutral", "hands": "mean"}
    assert "SMPL-X Model License" in run.built.body.license
    assert run.motion.rotation_correction.shape == (6, 55, 3)


def test_fingers_and_jaw_are_optimised_when_asked_for(run, capture, models, tmp_path):
    moved = run.motion.rotation_correction.abs().amax((0, 2))
    names = run.built.body.data.joint_names
    for name in ("jaw", FINGER, "right_middle2", "left_elbow"):
        assert moved[names.index(name)] > 1e-3
    plain = trained(capture, models[0], tmp_path / "r", "stage2.steps=0")
    assert plain.motion.rotation_correction.shape == (6, 22, 3)
    state = load_tensors(tmp_path / "r/stage1.pt")["motion"]["rotation_correction"]
    assert state.abs().max() > 0


def test_the_played_avatar_is_the_trained_one_and_its_hands_and_jaw_move(run, bundle, models):
    avatar, motion = Avatar(bundle), run.motion.motion()
    assert avatar.joint_names == models[1].joint_names
    for frame in (0, 5):
        got, expected = avatar.gaussians(*motion.at(frame)), posed(run, motion, frame)
        assert np.abs(got.means - expected.means.numpy()).max() < 1e-5  # float32, two engines, metres from the origin
        assert np.abs(got.colors - expected.colors.numpy()).max() < 1e-4
    rest = np.zeros((55, 3), np.float32)
    still = avatar.gaussians(rest).means.copy()  # the player fills its arrays again
    for joint, least in ((FINGER, 0.02), ("jaw", 0.02), ("right_pinky3", 0.003), ("left_eye_smplhf", 0.0005)):
        share = 0.1 if "eye" in joint else 0.7  # an eye is a point or two here
        rows, pose = points_of(avatar, joint, share), rest.copy()
        assert len(rows) > 0, joint
        pose[avatar.joint_names.index(joint)] = (0.8, 0, 0) if joint == "jaw" else (0, 0, 0.8)
        travel = np.linalg.norm(avatar.gaussians(pose).means - still, axis=1)
        assert travel[rows].max() > least, joint
        others = points_of(avatar, "right_knee")
        assert travel[others].max() < 2e-3  # what dynamics of twelve steps make of it


def test_hands_that_no_motion_moves_rest_in_their_mean(bundle, run):
    avatar = Avatar(bundle)
    body = Motion(np.zeros((1, 22, 3), np.float32), np.zeros((1, 3), np.float32), 30.0)
    fitted, ignored = avatar.fit(body)
    assert not ignored
    rest = run.built.body.data.rest_pose
    assert np.abs(rest[-30:]).max() > 0.3
    np.testing.assert_allclose(fitted.poses[0], rest, atol=1e-7)
    np.testing.assert_array_equal(avatar.fit(Motion(np.zeros((1, 55, 3)), np.zeros((1, 3)), 30.0))[0].poses, 0)
    np.testing.assert_array_equal(avatar.gaussians(body.poses[0]).means, avatar.gaussians(rest).means)


@pytest.mark.parametrize("name", ["wave", "turn"])
def test_motions_in_smplh_order_move_the_fingers_not_the_jaw(bundle, name):
    avatar = Avatar(bundle)
    motion = read_motion(name)
    fitted, ignored = avatar.fit(motion)
    assert not ignored
    assert fitted.poses.shape[1] == 55
    assert not fitted.poses[:, 22:25].any()
    np.testing.assert_array_equal(fitted.poses[:, 25:], motion.poses[:, 22:])


def test_a_bundle_holds_no_more_of_the_model_than_playing_needs(bundle, models):
    read = read_bundle(bundle)
    body = read.arrays("body.npz")
    assert set(body) == {"joint_names", "parents", "joints", "betas", "rest_pose", "hands_mean", "hands_components"}
    count = len(models[1].v_template)
    for member in ("surface.npz", "body.npz", "expression.npz"):
        for key, array in read.arrays(member).items():
            assert count not in array.shape, key  # nothing by vertex: no template, blendshapes, weights, regressor
    assert "SMPL-X Model License" in read.manifest.body["license"]


# expressions and hand coefficients


def test_training_poses_the_expression_of_the_capture(run):
    np.testing.assert_array_equal(run.motion.motion().expression, expressions())
    avatar, motion = run.avatar, run.motion.motion()
    with_it, without = (posed(run, m, 5).means for m in (motion, dataclasses.replace(motion, expression=None)))
    moved = np.linalg.norm(with_it - without, axis=1)
    mouth = expression_of(run.built.body.data, avatar.surface).rows
    assert moved.max() > 0.003  # metres
    still = np.setdiff1d(np.arange(len(moved)), mouth)
    assert moved[still].max() < 5e-4  # the head's joints rest on vertices that the mouth moves a little
    assert len(mouth) < 0.1 * len(moved)


def test_the_played_expression_is_the_trained_one(run, bundle):
    avatar, motion = Avatar(bundle), run.motion.motion()
    assert avatar.expression.count == 10
    rest = avatar.gaussians(motion.poses[5], motion.trans[5]).means.copy()
    got = avatar.gaussians(*motion.at(5)).means.copy()
    # float16 directions of at most 1 cm times coefficients of 2.5
    assert np.abs(got - posed(run, motion, 5).means.numpy()).max() < 2e-5
    assert np.abs(got - rest).max() > 0.003
    np.testing.assert_array_equal(avatar.gaussians(*motion.at(5)[:2], np.zeros(10)).means, rest)
    np.testing.assert_array_equal(avatar.gaussians(*motion.at(5)[:2], motion.expression[5, :2]).means, got)  # padded
    coarse = Avatar(bundle, gaussians=len(avatar) // 2)
    first = avatar.surface.rank < len(coarse)
    np.testing.assert_allclose(coarse.gaussians(*motion.at(5)).means, got[first], atol=1e-6)
    assert (coarse.expression.rows < len(coarse)).all()


def test_what_a_camera_sees_has_the_same_face(run, bundle):
    motion = run.motion.motion()
    view = run.capture.camera(run.capture.views("train")[0])
    whole, seen = Avatar(bundle), Avatar(bundle, seen_only=True)
    full, part = whole.gaussians(*motion.at(5)).means.copy(), seen.gaussians(*motion.at(5), camera=view).means
    if not seen.seen_only:
        pytest.skip("the full tier of this bundle decodes all or nothing")
    assert 0.2 * len(full) < len(part) < len(full)
    nearest = np.abs(part[:, None] - full[None, :]).max(-1).min(1)
    assert nearest.max() < 1e-6


def test_pose_blendshapes_are_trained_exported_and_played_when_asked_for(capture, models, tmp_path, bundle):
    small = ("avatar.pose_blendshapes=true", "encoder=none", "stage1.steps=2", "stage2.steps=0", "body.hands=mean")
    run = trained(capture, models[0], tmp_path / "run", *small)
    assert run.config.avatar.pose_blendshapes
    export(run, tmp_path / "a.gavatar")
    read = read_bundle(tmp_path / "a.gavatar")
    assert "pose_blendshapes.npz" in read.manifest.members
    assert "pose_blendshapes.npz" not in read_bundle(bundle).manifest.members
    avatar, motion = Avatar(read), run.motion.motion()
    with_it = avatar.gaussians(*motion.at(5)).means.copy()
    # float16 directions of millimetres
    assert np.abs(with_it - posed(run, motion, 5).means.numpy()).max() < 2e-5
    run.avatar.config = dataclasses.replace(run.avatar.config, pose_blendshapes=False)
    moved = np.linalg.norm(with_it - posed(run, motion, 5).means.numpy(), axis=1)
    assert 1e-3 < moved.max() < 0.05  # the model's are some 8 mm
    coarse = Avatar(read, gaussians=len(avatar) // 2)
    first = avatar.surface.rank < len(coarse)
    np.testing.assert_allclose(coarse.gaussians(*motion.at(5)).means, with_it[first], atol=1e-6)
    with pytest.raises(UserError, match="body 'free' has no pose blendshapes"):
        trained(capture, models[0], tmp_path / "free", *small[:4], "body=free")


def test_impossible_expressions_are_refused(bundle, run):
    avatar, pose = Avatar(bundle), np.zeros((55, 3), np.float32)
    with pytest.raises(ValueError, match=r"\(11,\), this avatar has 10"):
        avatar.gaussians(pose, None, np.ones(11))
    with pytest.raises(UserError, match="NaN"):
        avatar.gaussians(pose, None, np.full(10, np.nan))
    motion = Motion(pose[None], np.zeros((1, 3)), 30.0, expression=np.full((1, 10), np.inf))
    with pytest.raises(UserError, match="infinite expression at frame 0"):
        avatar.fit(motion)
    attributes, rest = run.avatar.attributes(), Pose(torch.eye(3).expand(1, 55, 3, 3), torch.zeros(1, 3))
    with pytest.raises(UserError, match="10 expression coefficients, not 11"):
        run.avatar.pose(attributes, dataclasses.replace(rest, expression=torch.ones(1, 11)))
    (none,) = run.avatar.pose(attributes, dataclasses.replace(rest, expression=torch.ones(1, 0)))
    assert torch.equal(none.means, run.avatar.pose(attributes, rest)[0].means)


def test_a_motion_file_with_coefficients_moves_face_and_fingers(bundle, models, tmp_path):
    rng, hands = np.random.default_rng(0), models[1].hands
    left, right = rng.normal(0, 0.6, (2, 2, 12))
    body = {"global_orient": np.zeros((2, 3)), "body_pose": np.zeros((2, 63)), "jaw_pose": np.zeros((2, 3))}
    hand = {"left_hand_pose": left, "right_hand_pose": right}
    np.savez(tmp_path / "m.npz", mocap_framerate=30, expression=expressions(2), **body, **hand)
    avatar = Avatar(bundle)
    motion, ignored = avatar.fit(read_motion(tmp_path / "m.npz", up="y"))
    assert ignored == ()
    expected = models[1].full_pose(left_hand=left, right_hand=right, pca=True)
    assert models[1].hands.relative is False  # `models` is read with flat hands; the file's are about the mean
    expected[:, -30:] += hands.mean.reshape(30, 3)
    np.testing.assert_allclose(motion.poses, expected, atol=1e-6)
    np.testing.assert_array_equal(motion.expression, expressions(2))
    out = tmp_path / "sheet.png"
    with pytest.raises(SystemExit) as done:
        play([str(bundle), "--motion", str(tmp_path / "m.npz"), "--out", str(out), "--size", "64"])
    assert done.value.code == 0
    assert out.exists()


def test_a_body_without_a_face_says_that_it_ignores_the_expression(capture, models):
    free = BODIES.build("free").data
    with pytest.warns(UserWarning, match="body 'free' has no expressions: those of .* are ignored"):
        assert capture_on_body(open_capture(capture), free).motion.expression is None


def test_poses_in_smplh_order_train_the_same_hands(models, tmp_path):
    """A capture whose body.npz has 52 joints: its fingers land on the fingers of the 55."""
    folder, data = models
    capture = write_smplx_capture(tmp_path / "c", data, size=48, joints=52)
    fitted = capture_on_body(open_capture(capture), data)
    poses, _ = hand_motion(data)
    poses[:, 22:25] = 0
    np.testing.assert_array_equal(fitted.motion.poses, poses)
    shutil.copy(capture / "body.npz", capture / "body_truth.npz")
    run = trained(capture, folder, tmp_path / "r", "stage1.steps=1", "stage2.steps=0", "encoder=none")
    assert motion_errors(run.built, run.capture.motion, run.capture.truth, [0, 5])[0] == 0
    exact = part_errors(run.built, run.capture.motion, run.capture.truth, [0, 5])
    assert (exact.mpjpe_hands_mm, exact.jaw_deg) == (0, None)  # 52 joints say nothing of a jaw


def test_errors_of_hands_and_jaw_are_apart_and_count_only_where_the_truth_moves_them(run, capture, tmp_path):
    truth = run.capture.motion
    names, frames = run.built.body.data.joint_names, [1, 5]
    off = dataclasses.replace(truth, poses=truth.poses.copy())
    off.poses[:, names.index("jaw"), 0] += np.radians(12)
    off.poses[:, names.index("left_shoulder"), 1] += 0.5  # counts with the body
    assert part_errors(run.built, off, truth, frames).jaw_deg == pytest.approx(12, abs=1e-3)
    off = dataclasses.replace(truth, poses=truth.poses.copy())
    off.poses[:, names.index("left_index2"), 2] += np.pi / 2
    errors = part_errors(run.built, off, truth, frames)
    joints = run.built.body.data.shaped(run.built.betas)[1]
    bone = np.linalg.norm((joints[names.index("left_index3")] - joints[names.index("left_index2")])[:2])
    # one of thirty joints travels by the chord of a quarter circle about z
    assert errors.mpjpe_hands_mm == pytest.approx(1000 * bone * np.sqrt(2) / 30, rel=1e-4)
    assert errors.jaw_deg < 1e-3
    assert motion_errors(run.built, off, truth, frames)[0] < 1e-4
    still = dataclasses.replace(truth, poses=truth.poses * (np.arange(55) < 22)[:, None])
    assert part_errors(run.built, off, still, frames).jaw_deg is None


def test_the_evaluation_reports_hands_and_jaw(run, capture, tmp_path):
    shutil.copytree(capture, tmp_path / "c")
    shutil.copy(capture / "body.npz", tmp_path / "c/body_truth.npz")
    opened = open_run(run.directory, capture=tmp_path / "c")
    result = evaluate(opened, ["train"], fit_steps=0, perceptual=False, progress=False)
    row = result.as_json()["rows"][0]
    assert row["mpjpe_hands_mm"] > 0
    assert row["jaw_deg"] > 0  # twelve steps moved it
    assert result.as_json()["train_mpjpe_hands_before_mm"] == 0
    text = str(result)
    assert "hands" in text
    assert "finger joints from their wrist" in text


def test_joints_that_the_body_lacks_are_named(capture, tmp_path):
    free = BODIES.build("free").data
    with pytest.warns(UserWarning, match=r"body 'free' lacks joints that move in .*: jaw$"):
        fitted = capture_on_body(open_capture(capture), free)
    assert fitted.motion.poses.shape[1] == 52


def test_a_capture_of_a_body_that_is_not_there_says_what_to_do(capture, tmp_path, monkeypatch):
    monkeypatch.delenv("GAVATAR_BODY_MODELS", raising=False)
    with pytest.raises(UserError, match=r"no neutral SMPL-X model.*https.*or body=free, though"):
        train(compose_config([f"capture={capture}", f"out={tmp_path / 'r'}", *SMALL]), tmp_path / "r")
    assert not (tmp_path / "r").exists()
    info = json.loads((capture / "capture.json").read_text())
    other = shutil.copytree(capture, tmp_path / "other")
    (other / "capture.json").write_text(json.dumps(info | {"body_model": "star"}))
    with pytest.raises(UserError, match="body_model is 'star'"):
        build_body({"name": "auto"}, open_capture(other))
    (other / "capture.json").write_text(json.dumps(info | {"gender": "female"}))
    with pytest.raises(UserError, match=r"no female SMPL-X model"):
        build_body({"name": "auto"}, open_capture(other))


def test_captures_of_the_free_body_need_no_files(tmp_path, monkeypatch):
    monkeypatch.delenv("GAVATAR_BODY_MODELS", raising=False)
    tiny = open_capture(write_tiny_capture(tmp_path / "tiny", frames=(0,), test=(), novel=()))
    assert tiny.body_model == "smplh"  # how it has been called so far
    assert build_body({"name": "auto"}, tiny).data.name == "free"
    assert BODIES.build("auto").data.name == "free"
    foreign = dataclasses.replace(tiny, body_model="smpl", placement=Placement(tiny.motion, "smpl", np.eye(3)))
    with pytest.warns(UserWarning, match=r"free body takes the place of smpl.*SMPL_NEUTRAL\.pkl.*https"):
        assert build_body({"name": "auto"}, foreign).data.name == "free"
    with pytest.raises(UserError, match=r"body\.path=/no/such"):
        build_body({"name": "auto", "path": "/no/such"}, foreign)


def test_the_canonical_surface_carries_the_canonical_pose_blendshapes(models):
    data = models[1]
    surface = sample_atlas(data, None, 64)
    corners = data.faces[surface.face]
    offsets = data.pose_offsets(data.canonical_pose())
    assert np.abs(offsets).max() > 5e-4
    vertices, _ = data.posed(data.canonical_pose())
    expected = np.einsum("nk,nkc->nc", surface.barycentric.astype(np.float64), vertices[corners])
    np.testing.assert_allclose(surface.points, expected, atol=1e-6)  # float32
