"""Results of pose estimators and data sets, each in the containers that people have them in."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import estimator_files as made
import numpy as np
import pytest
import torch
from motion_files import assert_same_rotations, walk

from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.source import motion_source

FRAMES = 12


def tensors(content: Any) -> Any:
    """The same with tensors for arrays of numbers."""
    if isinstance(content, dict):
        return {key: tensors(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [tensors(value) for value in content]
    return torch.from_numpy(content.copy()) if isinstance(content, np.ndarray) and content.dtype != object else content


def lists(content: Any) -> Any:
    """The same with lists for arrays."""
    if isinstance(content, dict):
        return {str(key): lists(value) for key, value in content.items()}
    if isinstance(content, (list, tuple, np.ndarray)):
        return [lists(value) for value in (content.tolist() if isinstance(content, np.ndarray) else content)]
    return content.item() if isinstance(content, np.generic) else content


def write(path: Path, content: Any) -> Path:
    """In the container of the suffix; `.compressed.pkl` is joblib's, `.tensors.npy` a pickle of tensors."""
    if path.name.endswith(".compressed.pkl"):
        pytest.importorskip("joblib").dump(content, path, compress=3)
    elif path.suffix == ".joblib":
        pytest.importorskip("joblib").dump(content, path)
    elif path.suffix == ".pkl":
        path.write_bytes(pickle.dumps(content, 2))
    elif path.suffix in (".pt", ".pth"):
        torch.save(tensors(content), path)
    elif path.suffix == ".json":
        path.write_text(json.dumps(lists(content)))
    elif path.suffix == ".npy":
        np.save(path, tensors(content) if ".tensors" in path.name else content, allow_pickle=True)
    else:
        arrays = content if all(isinstance(key, str) for key in content) else {"results": np.array(content, object)}
        np.savez(path, **arrays)
    return path


FILES = {
    "GVHMR": (made.gvhmr, ("a.pt", "a.compressed.pkl", "a.npz", "a.json")),
    "WHAM": (made.wham, ("wham_output.pkl", "a.joblib", "a.compressed.pkl", "a.npz", "a.pth")),
    "VIBE or PyMAF": (made.vibe, ("vibe_output.pkl", "a.joblib", "a.npy")),
    "PHALP or 4D-Humans": (made.phalp, ("a.compressed.pkl", "a.pkl", "a.npy")),
    "TRAM": (made.tram, ("hps_track_0.tensors.npy", "a.npy", "a.pt", "a.npz")),
    "SLAHMR": (made.slahmr, ("a_000060_world_results.npz", "a.pkl", "a.npy")),
    "3DPW": (made.three_dpw, ("a.pkl", "a.joblib")),
    "ROMP": (made.romp_frames, ("video_results.npz", "a.pkl")),
    "PyMAF-X": (made.pymaf_x, ("output.pkl", "a.joblib", "a.pt")),
    "Motion-X": (made.motion_x, ("a.npy", "a.pkl", "a.pt")),
    "Motion Diffusion Model": (made.mdm, ("sample00_rep00_smpl_params.npy", "a.pkl")),
    "AIST++": (made.aist, ("gBR.pkl", "a.npz", "a.pt", "a.pth", "a.json", "a.npy", "a.joblib")),
}
PLACED = set(FILES) - {"VIBE or PyMAF", "PHALP or 4D-Humans", "PyMAF-X"}  # they say where the person is


@pytest.mark.parametrize(("tool", "name"), [(tool, name) for tool, (_, names) in FILES.items() for name in names])
def test_a_result_in_any_container_is_read_as_it_was_stored(tmp_path, tool, name):
    truth = walk(FRAMES)
    source = motion_source(write(tmp_path / name, FILES[tool][0](truth)), up="y")
    motion = source.load()
    assert source.facts["written by"] == tool
    assert_same_rotations(motion, truth["poses"])
    assert motion.fps == {"AIST++": 60, "Motion Diffusion Model": 20}.get(tool, 30)
    # 1e-5: float32 through a division
    np.testing.assert_allclose(motion.trans, truth["trans"] if tool in PLACED else 0 * truth["trans"], atol=1e-5)
    if tool not in ("Motion Diffusion Model", "AIST++", "SLAHMR"):  # which store none here
        np.testing.assert_allclose(motion.betas, truth["betas"], atol=1e-6)
    known = tool in ("AIST++", "Motion-X", "Motion Diffusion Model", "3DPW")
    assert any("no frame rate" in note for note in motion.notes) != known


@pytest.mark.parametrize("tool", ["WHAM", "SLAHMR", "3DPW", "ROMP"])
def test_of_several_persons_the_longest_is_taken_and_the_others_are_named(tmp_path, tool):
    short, long = walk(FRAMES - 5, seed=1), walk(FRAMES)
    path = write(tmp_path / "a.pkl", FILES[tool][0](short, long))
    motion = read_motion(path, up="y")
    assert_same_rotations(motion, long["poses"])
    note = next(note for note in motion.notes if "2 persons" in note)
    other = {"WHAM": "0", "SLAHMR": "0", "3DPW": "0", "ROMP": "5"}[tool]
    assert f"`person={other}` takes another of {other} ({FRAMES - 5} frames)" in note
    assert_same_rotations(read_motion(path, up="y", person=other), short["poses"])
    with pytest.raises(UserError, match=rf"no person '77': choose from: {other}"):
        read_motion(path, person=77)


def test_frames_in_which_a_person_was_not_seen_lie_between_their_neighbours(tmp_path):
    truth = walk(FRAMES)
    motion = read_motion(write(tmp_path / "a.pkl", made.phalp(truth, unseen=(4, 5))), up="y")
    assert any("not seen at frames 4, 5: filled" in note for note in motion.notes)
    seen = [t for t in range(FRAMES) if t not in (4, 5)]
    assert_same_rotations(motion.taken(seen), truth["poses"][seen])
    # the turn of the pelvis is even: a third and two thirds of the way from frame 3 to 6; 1e-4: float32 matrices
    between = truth["poses"][3, 0] + (truth["poses"][6, 0] - truth["poses"][3, 0]) * np.array([[1], [2]]) / 3
    np.testing.assert_allclose(motion.poses[4:6, 0], between, atol=1e-4)


def test_the_persons_of_4d_humans_keep_their_numbers(tmp_path):
    short, long = walk(5, seed=1), walk(FRAMES)
    path = write(tmp_path / "a.pkl", made.phalp(long, other=short))
    assert_same_rotations(read_motion(path, up="y"), long["poses"])
    assert_same_rotations(read_motion(path, up="y", person=2), short["poses"])


def test_romp_stores_sequences_frames_and_single_images(tmp_path):
    one, two = walk(FRAMES), walk(FRAMES - 3, seed=1)
    path = write(tmp_path / "video_results.npz", made.romp_sequences(two, one))
    assert_same_rotations(read_motion(path, up="y", person=6), one["poses"])
    untracked = read_motion(write(tmp_path / "b.npz", made.romp_frames(two, one, tracked=False)), up="y")
    assert any("does not follow persons" in note for note in untracked.notes)
    image = made.romp_frames(one)["results"].item()["00000003.jpg"]
    image.pop("track_ids")
    motion = read_motion(write(tmp_path / "image.npz", {"results": np.array(image, object)}), up="y")
    assert_same_rotations(motion, one["poses"][3:4])


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_folder_of_easymocap_is_one_motion_a_person(tmp_path, wrapped):
    one, two = walk(FRAMES), walk(FRAMES - 2, seed=1)
    folder = tmp_path / "smpl"
    folder.mkdir()
    for t in range(FRAMES):
        people = [made.easymocap(one, t, 4)] + ([made.easymocap(two, t, 1)] if t < FRAMES - 2 else [])
        (folder / f"{t:06d}.json").write_text(json.dumps({"annots": people} if wrapped else people))
    motion = read_motion(folder, up="y")
    assert_same_rotations(motion, one["poses"])
    np.testing.assert_allclose(motion.trans, one["trans"], atol=1e-5)  # about the pelvis again
    assert any(note.startswith("2 persons: 4 is taken") for note in motion.notes)
    assert_same_rotations(read_motion(folder, up="y", person=1), two["poses"])
    single = read_motion(folder / "000003.json", up="y", person=4)
    assert_same_rotations(single, one["poses"][3:4])


def test_easymocap_may_leave_the_root_out_and_add_hands_and_face(tmp_path):
    truth = walk(FRAMES)
    turn = {"Rh": truth["poses"][:, 0], "Th": truth["trans"], "shapes": truth["betas"][None]}
    np.savez(tmp_path / "a.npz", poses=made.flat(truth["poses"][:, 1:]), **turn)
    assert_same_rotations(read_motion(tmp_path / "a.npz", up="y"), truth["poses"])
    hands, face = np.full((FRAMES, 12), 0.2), np.full((FRAMES, 9), 0.1)
    body = np.concatenate([np.zeros((FRAMES, 3)), made.flat(truth["poses"][:, 1:22]), hands, face], 1)
    np.savez(tmp_path / "x.npz", poses=body, **turn)
    motion = read_motion(tmp_path / "x.npz", up="y")
    assert motion.poses.shape == (FRAMES, 55, 3)
    assert_same_rotations(motion, truth["poses"])
    np.testing.assert_allclose(motion.poses[:, 22:25], 0.1, atol=1e-6)
    assert motion.hands.values.shape == (FRAMES, 2, 6)
    assert motion.hands.pca


@pytest.mark.parametrize("nested", [False, True])
def test_a_folder_of_smplify_x_is_one_motion(tmp_path, nested):
    truth = walk(FRAMES)
    for t in range(FRAMES):
        path = tmp_path / "results" / (f"{t}/000.pkl" if nested else f"{t}.pkl")  # 10 comes after 9
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, made.smplify_x(truth, t))
    motion = read_motion(tmp_path / "results", up="y")
    assert_same_rotations(motion, truth["poses"])
    assert motion.hands.values.shape == (FRAMES, 2, 12)
    assert any("stays in place" in note for note in motion.notes)


def test_a_folder_of_nothing_or_of_everything_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match=r"empty holds no file of poses"):
        read_motion(tmp_path / "empty")
    write(tmp_path / "a.pkl", made.smplify_x(walk(1), 0))
    write(tmp_path / "a.json", [made.easymocap(walk(1), 0)])
    with pytest.raises(UserError, match=r"several kinds \(\.json, \.pkl\)"):
        read_motion(tmp_path)


def test_a_list_of_frames_is_one_motion(tmp_path):
    truth = walk(FRAMES)
    frames = [
        {"global_orient": R[:1], "body_pose": R[1:], "betas": np.zeros((1, 10))} for R in made.matrices(truth["poses"])
    ]
    assert_same_rotations(read_motion(write(tmp_path / "a.pkl", frames), up="y"), truth["poses"])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.pkl", made.smplify_x(walk(1), 0) | {"body_pose": np.zeros((1, 32))}, r"VPoser's code of 32.*SMPLify-X"),
        ("a.npy", np.zeros((9, 263)), "HumanML3D trains on"),
        ("a.npy", {"motion": np.zeros((2, 22, 3, 9)), "lengths": np.ones(2)}, "Motion Diffusion Model"),
        ("a.json", [{"id": 0, "keypoints3d": np.zeros((25, 4))}], "joint positions of EasyMocap: its folder smpl"),
        ("a.json", {"version": 1.3, "people": [{"pose_keypoints_2d": [1, 2, 3]}]}, "OpenPose's keypoints"),
        ("a.pkl", {1: {"joints3d": np.zeros((5, 49, 3)), "frame_ids": np.arange(5)}}, "positions of joints"),
        ("a.npz", {"pred_cam_R": np.zeros((5, 3, 3)), "pred_cam_T": np.zeros((5, 3))}, "TRAM's camera"),
        ("a.npz", {"v_template": np.zeros((5, 3)), "J_regressor": np.zeros((2, 5))}, "a body model, not a motion"),
        ("a.npz", {"latent_pose": np.zeros((5, 32)), "trans": np.zeros((5, 3))}, "a code of a pose"),
    ],
)
def test_positions_and_codes_are_refused_with_the_tools_name_and_the_way_out(tmp_path, name, content, message):
    with pytest.raises(UserError, match=message) as raised:
        read_motion(write(tmp_path / name, content))
    assert name in str(raised.value)
    assert "\n" not in str(raised.value)
