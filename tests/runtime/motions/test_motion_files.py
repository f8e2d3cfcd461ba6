"""Motion files of other people: SMPL-family fields, AIST++ and torch pickles, BVH retargeted by joint names."""

from __future__ import annotations

import dataclasses
import json
import pickle
import warnings
from pathlib import Path

import numpy as np
import places
import pytest
import torch
from make_bundle import free_body

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.bvh_file import read_bvh
from gavatar_runtime.formats.torch_file import load_torch
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.fitting import scaled_to_legs
from gavatar_runtime.motions.motion_file import write_motion
from gavatar_runtime.motions.rig_names import match_rig, split_name
from gavatar_runtime.values.motion import joined
from gavatar_runtime.values.skeletons import SMPLH, SMPLX

SHARED = places.SHARED / "motions"


def numbers(*shape, seed=0, scale=0.3):
    return np.random.default_rng(seed).normal(0, scale, shape).astype(np.float32)


# fields of the SMPL family


def test_amass_smplx_parts_come_in_smplx_order(tmp_path):
    parts = {"root_orient": 3, "pose_body": 63, "pose_hand": 90, "pose_jaw": 3, "pose_eye": 6}
    arrays = {name: numbers(5, width, seed=i) for i, (name, width) in enumerate(parts.items())}
    np.savez(tmp_path / "a.npz", trans=numbers(5, 3), mocap_frame_rate=120.0, **arrays)
    motion = read_motion(tmp_path / "a.npz", up="y")
    assert motion.poses.shape == (5, 55, 3)
    flat = motion.poses.reshape(5, -1)
    order = ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand")
    np.testing.assert_array_equal(flat, np.concatenate([arrays[n] for n in order], 1))
    jaw = SMPLX.index("jaw")
    np.testing.assert_array_equal(motion.poses[:, jaw], arrays["pose_jaw"])


def test_parts_of_smplh_have_no_face_and_smplx_package_names_are_read(tmp_path):
    np.savez(
        tmp_path / "h.npz", global_orient=numbers(4, 3), body_pose=numbers(4, 63), transl=numbers(4, 3), fps=25,
        left_hand_pose=numbers(1, 45, seed=1), right_hand_pose=numbers(1, 45, seed=2), betas=np.zeros((4, 10)),
    )  # fmt: skip
    motion = read_motion(tmp_path / "h.npz", up="y")
    assert motion.poses.shape == (4, 52, 3)
    assert motion.fps == 25
    assert motion.betas.shape == (10,)
    np.testing.assert_array_equal(motion.poses[3, 22:37].reshape(-1), numbers(1, 45, seed=1)[0])  # one hand for all


def test_smpl_parts_have_24_joints_and_one_frame_may_lack_its_axis(tmp_path):
    np.savez(tmp_path / "s.npz", global_orient=numbers(3), body_pose=numbers(69), mocap_framerate=30)
    assert read_motion(tmp_path / "s.npz").poses.shape == (1, 24, 3)


def parts(frames=2, **fields):
    """The fields of a body without hands, and others."""
    return {"global_orient": numbers(frames, 3), "body_pose": numbers(frames, 63), "mocap_framerate": 30, **fields}


@pytest.mark.parametrize("width", [1, 6, 12, 44])
def test_hand_coefficients_are_kept_until_a_body_is_known(tmp_path, width):
    left, right = numbers(2, width), numbers(1, width, seed=1)
    np.savez(tmp_path / "p.npz", **parts(left_hand_pose=left, right_hand_pose=right))
    motion = read_motion(tmp_path / "p.npz")
    assert motion.poses.shape == (2, 22, 3)
    assert (motion.hands.pca, motion.hands.relative) == (True, True)
    np.testing.assert_array_equal(motion.hands.values, np.stack([left, np.repeat(right, 2, 0)], 1))


@pytest.mark.parametrize(
    ("options", "fields", "expected"),
    [
        ({}, {}, None),
        ({"hand_mean": "flat"}, {}, None),
        ({"hand_mean": "mean"}, {}, (False, True)),
        ({"hands": "pca"}, {}, (True, True)),
        ({"hands": "pca", "hand_mean": "flat"}, {}, (True, False)),
        ({}, {"use_pca": True}, (True, True)),
        ({}, {"use_pca": True, "flat_hand_mean": True}, (True, False)),
        ({}, {"flat_hand_mean": False}, (False, True)),
        ({}, {"use_pca": False, "flat_hand_mean": np.array([True])}, None),
        ({"hands": "full"}, {"use_pca": True}, None),
    ],
)
def test_45_numbers_are_rotations_unless_the_file_or_an_option_says_otherwise(tmp_path, options, fields, expected):
    hands = {"left_hand_pose": numbers(2, 45), "right_hand_pose": numbers(2, 45, seed=1)}
    np.savez(tmp_path / "p.npz", **parts(**hands, **fields))
    motion = read_motion(tmp_path / "p.npz", **options)
    if expected is None:
        assert motion.hands is None
        np.testing.assert_array_equal(motion.poses[:, 22:37].reshape(2, 45), hands["left_hand_pose"])
    else:
        assert (motion.hands.pca, motion.hands.relative) == expected
        assert motion.poses.shape == (2, 22, 3)
        np.testing.assert_array_equal(motion.hands.values[:, 1], hands["right_hand_pose"])


@pytest.mark.parametrize(("width", "count"), [(78, 6), (90, 12)])
def test_compact_poses_of_smplh_end_in_coefficients(tmp_path, width, count):
    poses = numbers(3, width)
    np.savez(tmp_path / "p.npz", poses=poses, mocap_framerate=30)
    motion = read_motion(tmp_path / "p.npz", up="y")
    np.testing.assert_array_equal(motion.poses.reshape(3, 66), poses[:, :66])
    np.testing.assert_array_equal(motion.hands.values.reshape(3, -1), poses[:, 66:])
    assert motion.hands.values.shape == (3, 2, count)


def test_whole_poses_about_the_mean_hand_are_split_off_and_fingers_that_move_win_over_coefficients(tmp_path):
    poses = numbers(2, 165)
    np.savez(tmp_path / "p.npz", poses=poses, mocap_framerate=30)
    motion = read_motion(tmp_path / "p.npz", up="y", hand_mean="mean")
    assert not motion.poses[:, 25:].any()
    np.testing.assert_array_equal(motion.hands.values.reshape(2, 90), poses[:, 75:])
    np.testing.assert_array_equal(motion.poses[:, :25].reshape(2, 75), poses[:, :75])
    both = {"left_hand_pose": numbers(2, 6), "right_hand_pose": numbers(2, 6)}
    np.savez(tmp_path / "b.npz", poses=poses, mocap_framerate=30, **both)
    assert read_motion(tmp_path / "b.npz").hands is None
    poses[:, 75:] = 0
    np.savez(tmp_path / "c.npz", poses=poses, mocap_framerate=30, **both)
    assert read_motion(tmp_path / "c.npz").hands.values.shape == (2, 2, 6)


@pytest.mark.parametrize(
    ("fields", "options", "message"),
    [
        ({"left_hand_pose": numbers(2, 6), "right_hand_pose": numbers(2, 12)}, {}, "both hands must be alike"),
        ({"left_hand_pose": numbers(2, 6), "right_hand_pose": numbers(2, 6)}, {"hands": "full"}, "6 numbers a hand"),
        ({"left_hand_pose": numbers(2, 46), "right_hand_pose": numbers(2, 46)}, {}, "46 numbers a hand"),
        ({"left_hand_pose": numbers(3, 6), "right_hand_pose": numbers(3, 6)}, {}, "hand poses 3"),
        ({"pose_hand": numbers(2, 25)}, {}, "no two hands"),
        ({"pose_hand": numbers(2, 12), "use_pca": "yes"}, {}, "use_pca must be true or false"),
        ({"pose_hand": np.full((2, 12), np.nan)}, {}, "pose_hand holds NaN or infinite values at frames 0, 1"),
        ({"pose_hand": numbers(2, 12)}, {"hands": "pcs"}, "hands=pcs: choose from auto, full, pca"),
        ({"pose_hand": numbers(2, 12)}, {"hand_mean": "x"}, "hand_mean=x: choose"),
        ({"expression": numbers(3, 10)}, {}, r"expression has shape \(3, 10\), expected \(2, E\)"),
        ({"expression": np.full((2, 10), np.inf)}, {}, "expression holds NaN or infinite"),
        ({"expression": np.array([["x"]])}, {}, "expression holds <U1"),
        ({"jaw_pose": numbers(2, 4)}, {}, "jaw_pose holds 4 numbers a frame, expected 3"),
        ({"leye_pose": numbers(2, 3), "reye_pose": numbers(5, 3)}, {}, "different numbers of frames"),
    ],
)
def test_faulty_hands_and_faces_are_named(tmp_path, fields, options, message):
    np.savez(tmp_path / "f.npz", **parts(**fields))
    with pytest.raises(UserError, match=message):
        read_motion(tmp_path / "f.npz", **options)


@pytest.mark.parametrize("shape", [(4, 10), (1, 50), (10,)])
def test_expressions_are_read_a_row_a_frame_or_one_for_all(tmp_path, shape):
    values = numbers(*shape)
    np.savez(tmp_path / "e.npz", **parts(4, expression=values, jaw_pose=numbers(4, 3)))
    motion = read_motion(tmp_path / "e.npz")
    assert motion.poses.shape == (4, 55, 3)
    np.testing.assert_array_equal(motion.expression, np.broadcast_to(values, (4, shape[-1])))


def test_expressions_and_coefficients_are_resampled_and_written(tmp_path):
    hands = {"left_hand_pose": numbers(3, 6), "right_hand_pose": numbers(3, 6, seed=1), "flat_hand_mean": True}
    np.savez(tmp_path / "e.npz", **parts(3, expression=numbers(3, 10), **hands))
    motion = read_motion(tmp_path / "e.npz", up="y")
    double = motion.resampled(60)
    assert len(double) == 5
    for mine, theirs in ((double.expression, motion.expression), (double.hands.values, motion.hands.values)):
        np.testing.assert_array_equal(mine[::2], theirs)
        np.testing.assert_allclose(mine[1], (theirs[0] + theirs[1]) / 2, atol=1e-7)
    write_motion(tmp_path / "w.npz", double)
    back = read_motion(tmp_path / "w.npz", up="y")
    np.testing.assert_array_equal(back.poses, double.poses)
    np.testing.assert_array_equal(back.expression, double.expression)
    np.testing.assert_array_equal(back.hands.values, double.hands.values)
    assert (back.hands.pca, back.hands.relative) == (True, False)
    last = back.taken([4])
    assert (len(last), last.expression.shape, last.hands.values.shape) == (1, (1, 10), (1, 2, 6))
    assert last.resampled(30).expression.shape == (1, 10)  # one frame stays one
    twice = joined([back, back])
    assert (len(twice), twice.expression.shape, twice.hands.values.shape) == (10, (10, 10), (10, 2, 6))
    assert joined([back, dataclasses.replace(back, expression=None, hands=None)]).expression is None


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"global_orient": numbers(2, 3), "body_pose": numbers(2, 60)}, "body_pose holds 60 numbers a frame"),
        ({"global_orient": numbers(2, 4), "body_pose": numbers(2, 63)}, "global_orient holds 4 numbers"),
        ({"global_orient": numbers(3, 3), "body_pose": numbers(2, 63)}, "body_pose has 2 frames and global_orient 3"),
        ({"body_pose": numbers(2, 63)}, "'poses' is missing"),
        ({"global_orient": numbers(0, 3), "body_pose": numbers(0, 63)}, "no frame"),
        ({"global_orient": numbers(2, 3), "body_pose": np.full((2, 63), np.nan)}, "body_pose holds NaN"),
        ({"global_orient": numbers(2, 3), "body_pose": numbers(2, 63), "transl": numbers(2, 2)}, "transl has shape"),
    ],
)
def test_faulty_parts_are_named(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", mocap_framerate=30, **arrays)
    with pytest.raises(UserError, match=message) as raised:
        read_motion(tmp_path / "a.npz")
    assert "a.npz" in str(raised.value)


def test_a_motion_in_the_axes_of_a_camera_is_turned_upright(tmp_path):
    flip = np.diag([1.0, -1, -1])
    turn = matrix_from_axis_angle(np.array([0.1, 0.7, 0.2]))
    poses = np.zeros((2, 72))
    poses[:, :3] = axis_angle_from_matrix(flip @ turn)
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.array([[1.0, 2, 3]] * 2), mocap_framerate=30)
    motion = read_motion(tmp_path / "a.npz")
    # 2e-6: float32 angles near pi
    np.testing.assert_allclose(matrix_from_axis_angle(motion.poses[0, 0].astype(float)), turn, atol=2e-6)
    np.testing.assert_allclose(motion.trans[0], [1, -2, -3])


# pickles


def test_an_aist_motion_is_scaled_to_metres_at_60_frames(tmp_path):
    content = {"smpl_poses": numbers(6, 72), "smpl_trans": numbers(6, 3, scale=90), "smpl_scaling": np.array([93.78])}
    (tmp_path / "gBR.pkl").write_bytes(pickle.dumps(content))
    motion = read_motion(tmp_path / "gBR.pkl", up="y")
    assert (motion.fps, motion.poses.shape) == (60, (6, 24, 3))
    np.testing.assert_allclose(motion.trans, content["smpl_trans"] / 93.78, rtol=1e-6)


def test_a_dance_by_edge_runs_at_30_frames_in_metres_and_is_turned_upright(tmp_path):
    turn = np.tile([np.pi / 2, 0, 0], (6, 1))  # z-up
    content = {"smpl_poses": np.concatenate([turn, numbers(6, 69)], 1), "smpl_trans": numbers(6, 3),
               "full_pose": numbers(6, 24, 3)}  # fmt: skip
    (tmp_path / "edge.pkl").write_bytes(pickle.dumps(content))
    motion = read_motion(tmp_path / "edge.pkl")
    assert (motion.fps, len(motion)) == (30, 6)
    np.testing.assert_allclose(motion.poses[:, 0], 0, atol=1e-6)
    np.testing.assert_allclose(motion.trans, content["smpl_trans"] @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-6)


def test_amass_files_of_smplx_with_all_that_they_hold_are_read(tmp_path):
    """The keys of AMASS's *_stageii.npz of 2022 and later, some of them objects."""
    parts = {"root_orient": 3, "pose_body": 63, "pose_jaw": 3, "pose_eye": 6, "pose_hand": 90}
    arrays = {name: numbers(4, width, seed=i).astype(float) for i, (name, width) in enumerate(parts.items())}
    np.savez(
        tmp_path / "a_stageii.npz", gender="neutral", surface_model_type=np.array("smplx", object),
        mocap_frame_rate=120.0, mocap_time_length=4 / 120, markers_latent=numbers(53, 3),
        latent_labels=np.array(["ARIEL"] * 53), markers_latent_vids=np.array({"ARIEL": 1}, object),
        trans=numbers(4, 3), poses=np.concatenate(list(arrays.values()), 1), betas=numbers(16), num_betas=16, **arrays,
    )  # fmt: skip
    motion = read_motion(tmp_path / "a_stageii.npz", up="y")
    assert (motion.poses.shape, motion.fps, motion.betas.shape) == ((4, 55, 3), 120, (16,))
    assert motion.hands is None
    np.testing.assert_array_equal(motion.poses[:, SMPLX.index("jaw")], arrays["pose_jaw"].astype(np.float32))
    np.testing.assert_array_equal(motion.poses[:, 25:].reshape(4, 90), arrays["pose_hand"].astype(np.float32))


def test_numpy_arrays_in_a_pth_are_read_as_tensors_are(tmp_path):
    content = {"beta": np.zeros((1, 10)), "body_pose": numbers(3, 72), "trans": numbers(3, 3)}
    torch.save(content, tmp_path / "smpl_parms.pth")
    motion = read_motion(tmp_path / "smpl_parms.pth", up="y")
    np.testing.assert_array_equal(motion.poses.reshape(3, 72), content["body_pose"])


@pytest.mark.parametrize("scaling", [np.array([0.0]), np.array([np.nan]), np.ones(2), np.array(["x"])])
def test_a_senseless_aist_scaling_is_named(tmp_path, scaling):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"smpl_poses": numbers(2, 72), "smpl_scaling": scaling}))
    with pytest.raises(UserError, match=r"a\.pkl.*smpl_scaling"):
        read_motion(tmp_path / "a.pkl")


def test_a_pickle_of_something_else_is_named(tmp_path):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps([1, 2]))
    with pytest.raises(UserError, match="list, expected a dictionary"):
        read_motion(tmp_path / "a.pkl")


class Bomb:
    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return (open, (self.path, "w"))


@pytest.mark.parametrize("suffix", [".pkl", ".pth"])
def test_a_hostile_file_is_refused_and_runs_nothing(tmp_path, suffix):
    content = {"body_pose": torch.zeros(2, 72), "bomb": Bomb(tmp_path / "exploded")}
    if suffix == ".pth":
        torch.save(content, tmp_path / "a.pth")
    else:
        (tmp_path / "a.pkl").write_bytes(pickle.dumps({"smpl_poses": numbers(2, 72), "bomb": content["bomb"]}))
    with pytest.raises(UserError, match=f"a{suffix} asks for .*open.*nothing ran"):
        read_motion(tmp_path / f"a{suffix}")
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.int64, torch.uint8, torch.bool])
def test_tensors_read_without_torch_equal_what_torch_reads(tmp_path, dtype):
    whole = (torch.arange(24).reshape(4, 6) % 2 if dtype == torch.bool else torch.arange(24).reshape(4, 6)).to(dtype)
    content = {
        "whole": whole, "transposed": whole.T, "part": whole[1:3, ::2], "one": whole[2, 3], "none": whole[:0],
        "expanded": whole[:1].expand(3, 6), "shared": [whole[0], whole[1]], "text": "x", "number": 3,
        "parameter": torch.nn.Parameter(torch.ones(2)),
    }  # fmt: skip
    torch.save(content, tmp_path / "a.pth")
    mine, theirs = load_torch(tmp_path / "a.pth"), torch.load(tmp_path / "a.pth", weights_only=True)
    assert mine["text"] == "x"
    assert mine["number"] == 3
    for key in ("whole", "transposed", "part", "one", "none", "expanded", "parameter"):
        np.testing.assert_array_equal(mine[key], theirs[key].detach().numpy(), err_msg=key)
        assert mine[key].dtype == theirs[key].detach().numpy().dtype
    np.testing.assert_array_equal(mine["shared"][1], theirs["shared"][1].numpy())


def test_damaged_and_old_torch_files_are_one_sentence(tmp_path):
    torch.save({"body_pose": torch.zeros(2, 72)}, tmp_path / "old.pth", _use_new_zipfile_serialization=False)
    torch.save({"body_pose": torch.zeros(2, 72)}, tmp_path / "cut.pth")
    (tmp_path / "cut.pth").write_bytes((tmp_path / "cut.pth").read_bytes()[:300])
    (tmp_path / "empty.pth").write_bytes(b"")
    for name in ("old.pth", "cut.pth", "empty.pth"):
        with pytest.raises(UserError, match=name) as raised:
            read_motion(tmp_path / name)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("width", [72, 165])
def test_upstream_parameters_are_read(tmp_path, width):
    content = {"beta": torch.zeros(1, 10), "body_pose": torch.randn(3, width) * 0.1, "trans": torch.randn(3, 3)}
    torch.save(content, tmp_path / "smpl_parms.pth")
    motion = read_motion(tmp_path / "smpl_parms.pth", up="y")
    assert motion.poses.shape == (3, width // 3, 3)
    assert motion.betas.shape == (10,)
    assert motion.fps == 30
    np.testing.assert_array_equal(motion.trans, content["trans"].numpy())


# BVH

# name, parent, offset in a y-up T-pose that faces +z, left at +x; units of a hundredth of a metre
MIXAMO = [
    ("Hips", None, (0, 95, 0)), ("Spine", "Hips", (0, 10, 0)), ("Spine1", "Spine", (0, 12, 0)),
    ("Spine2", "Spine1", (0, 12, 0)), ("Neck", "Spine2", (0, 18, 0)), ("Head", "Neck", (0, 8, 2)),
    *(
        entry
        for side, x in (("Left", 1), ("Right", -1))
        for entry in (
            (f"{side}Shoulder", "Spine2", (6 * x, 12, 0)), (f"{side}Arm", f"{side}Shoulder", (12 * x, 0, 0)),
            (f"{side}ForeArm", f"{side}Arm", (27 * x, 0, 0)), (f"{side}Hand", f"{side}ForeArm", (25 * x, 0, 0)),
            (f"{side}HandIndex1", f"{side}Hand", (9 * x, 0, 2)),
            (f"{side}UpLeg", "Hips", (9 * x, -5, 0)), (f"{side}Leg", f"{side}UpLeg", (0, -42, 0)),
            (f"{side}Foot", f"{side}Leg", (0, -41, 0)), (f"{side}ToeBase", f"{side}Foot", (0, -7, 12)),
        )
    ),
]  # fmt: skip
CMU_NAMES = {
    "Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1", "LeftHandIndex1": "LeftFingerBase",
    "RightHandIndex1": "RightFingerBase",
}  # fmt: skip
POSER_NAMES = {
    "Hips": "hip", "Spine": "abdomen", "Spine1": "chest", "Spine2": "chest2", "Neck": "neck", "Head": "head",
    **{
        f"{side}{a}": f"{letter}{b}"
        for side, letter in (("Left", "l"), ("Right", "r"))
        for a, b in {
            "Shoulder": "Collar", "Arm": "Shldr", "ForeArm": "ForeArm", "Hand": "Hand", "UpLeg": "Thigh", "Leg": "Shin",
            "Foot": "Foot", "ToeBase": "Toe", "HandIndex1": "Index1",
        }.items()
    },
}  # fmt: skip
ORDER = "ZXY"


def write_bvh(path, angles, root, *, world=None, lowered=0.0, rename=None, prefix="", unit=1.0, fps=30):
    """A BVH file of the rig above. angles: (T, J, 3) degrees about Z, X, Y. world: (3, 3) from its axes to the file's.
    lowered: degrees that the rest pose's arms hang. Returns (names, offsets) as they stand in the file."""
    world = np.eye(3) if world is None else world
    children: dict = {}
    for name, parent, _ in MIXAMO:
        children.setdefault(parent, []).append(name)
    offsets = {}
    for name, _, offset in MIXAMO:
        offset = np.array(offset, float)
        if any(part in name for part in ("ForeArm", "Hand")):
            sign = -1 if name.startswith("Left") else 1
            offset = matrix_from_axis_angle(np.radians([0, 0, sign * lowered])) @ offset
        offsets[name] = world @ offset * unit
    called = {n: prefix + (rename or {}).get(n, n) for n, _, _ in MIXAMO}
    lines, order = ["HIERARCHY"], []

    def joint(name, depth):
        pad = "  " * depth
        order.append(name)
        channels = "6 Xposition Yposition Zposition" if depth == 0 else "3"
        lines.append(f"{pad}{'JOINT' if depth else 'ROOT'} {called[name]}")
        lines.append(f"{pad}{{")
        lines.append(f"{pad}  OFFSET {' '.join(f'{v:.6f}' for v in offsets[name])}")
        lines.append(f"{pad}  CHANNELS {channels} " + " ".join(f"{a}rotation" for a in ORDER))
        for child in children.get(name, []):
            joint(child, depth + 1)
        if name not in children:
            lines.extend([f"{pad}  End Site", f"{pad}  {{", f"{pad}    OFFSET 0 1 0", f"{pad}  }}"])
        lines.append(f"{pad}}}")

    joint("Hips", 0)
    lines += ["MOTION", f"Frames: {len(angles)}", f"Frame Time: {1 / fps:.8f}"]
    index = [[n for n, _, _ in MIXAMO].index(name) for name in order]
    for row, place in zip(angles, root, strict=True):
        place = world @ np.asarray(place, float) * unit
        lines.append(" ".join(f"{v:.6f}" for v in [*place, *row[index].reshape(-1)]))
    Path(path).write_text("\n".join(lines) + "\n")


Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # x stays, y becomes z
LIMBS = {"hip": ("UpLeg", "Leg"), "knee": ("Leg", "Foot"), "shoulder": ("Arm", "ForeArm"), "elbow": ("ForeArm", "Hand")}
NEXT = {"hip": "knee", "knee": "ankle", "shoulder": "elbow", "elbow": "wrist"}
RIGS = {
    "Mixamo, y-up, cm": {"prefix": "mixamorig:"},
    "CMU, arms hanging, inches": {"rename": CMU_NAMES, "lowered": 85.0, "unit": 1 / 2.54},
    "z-up, metres, A-pose": {"world": Z_UP, "lowered": 40.0, "unit": 0.01},
    "Poser": {"rename": POSER_NAMES},
}


def random_angles(frames, seed=0, scale=25):
    angles = np.random.default_rng(seed).normal(0, scale, (frames, len(MIXAMO), 3))
    angles[:, 0] *= 0.5  # upright on average
    return angles


def directions(places, name, following):
    bone = places[:, following] - places[:, name]
    return bone / np.linalg.norm(bone, axis=-1, keepdims=True)


@pytest.mark.parametrize("rig", RIGS)
def test_every_limb_points_where_the_rigs_limb_points(tmp_path, rig):
    frames = 12
    root = np.stack([np.linspace(0, 100, frames), np.full(frames, 95.0), np.zeros(frames)], 1)
    write_bvh(tmp_path / "a.bvh", random_angles(frames), root, **RIGS[rig])
    world = RIGS[rig].get("world", np.eye(3))
    source = read_bvh(tmp_path / "a.bvh")
    places = source.places(source.world_rotations()) @ world  # back in the y-up axes
    mapping = match_rig(source.names, source.parents)

    motion = read_motion(tmp_path / "a.bvh")
    body = free_body()
    _, rest = body.shaped(None)
    joints = joint_transforms(motion.poses.astype(np.float64), rest, body.parents)[..., :3, 3]
    for side in ("left", "right"):
        for part, following in NEXT.items():
            mine = directions(joints, SMPLH.index(f"{side}_{part}"), SMPLH.index(f"{side}_{following}"))
            theirs = directions(places, mapping[f"{side}_{part}"], mapping[f"{side}_{following}"])
            angle = np.degrees(np.arccos(np.clip((mine * theirs).sum(-1), -1, 1)))
            # the free body's resting limbs are within 3 degrees of the directions that retargeting assumes
            assert angle.max() < 3, (side, part)
    hips = directions(joints, SMPLH.index("right_hip"), SMPLH.index("left_hip"))
    theirs = directions(places, mapping["right_hip"], mapping["left_hip"])
    assert np.degrees(np.arccos(np.clip((hips * theirs).sum(-1), -1, 1))).max() < 2  # its hips are level within 2


@pytest.mark.parametrize("rig", RIGS)
def test_the_walk_is_scaled_to_the_legs_of_the_body(tmp_path, rig):
    root = np.array([[0, 95, 0], [83.0, 95, 0]])  # the rig's leg is 83 long: one leg sideways
    write_bvh(tmp_path / "a.bvh", np.zeros((2, len(MIXAMO), 3)), root, **RIGS[rig])
    motion = read_motion(tmp_path / "a.bvh")
    body = free_body()
    _, rest = body.shaped(None)
    scaled = scaled_to_legs(motion, body.joint_names, rest)
    hip, knee, ankle = (rest[SMPLH.index(f"left_{n}")] for n in ("hip", "knee", "ankle"))
    leg = np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle)
    np.testing.assert_allclose(scaled.trans[1] - scaled.trans[0], [leg, 0, 0], atol=1e-5)  # float32, file's 6 digits
    assert scaled.leg_length == pytest.approx(leg)


def test_stated_units_are_kept_whatever_the_legs(tmp_path):
    write_bvh(tmp_path / "a.bvh", np.zeros((2, len(MIXAMO), 3)), [[0, 95, 0], [100, 95, 0]])
    motion = read_motion(tmp_path / "a.bvh", units="cm")
    np.testing.assert_allclose(motion.trans, [[0, 0.95, 0], [1, 0.95, 0]], atol=1e-6)
    assert motion.leg_length is None


def test_a_half_turn_and_a_rest_pose_are_exact(tmp_path):
    angles = np.zeros((2, len(MIXAMO), 3))
    angles[1, 0, 2] = 180  # about Y
    write_bvh(tmp_path / "a.bvh", angles, np.zeros((2, 3)))
    motion = read_motion(tmp_path / "a.bvh")
    np.testing.assert_allclose(motion.poses[0, SMPLH.index("pelvis")], 0, atol=1e-7)
    np.testing.assert_allclose(np.abs(motion.poses[1, 0]), [0, np.pi, 0], atol=1e-6)
    spine = [SMPLH.index(n) for n in ("spine1", "spine2", "spine3", "neck", "head", "left_foot")]
    np.testing.assert_allclose(motion.poses[:, spine], 0, atol=1e-6)


def zxy_degrees(R):
    """(..., 3) angles about Z, X and Y, applied in that order about the turned axes, of rotations (..., 3, 3)."""
    z, x = np.arctan2(-R[..., 0, 1], R[..., 1, 1]), np.arcsin(np.clip(R[..., 2, 1], -1, 1))
    return np.degrees(np.stack([z, x, np.arctan2(-R[..., 2, 0], R[..., 2, 2])], -1))


def scrambled(bvh, seed=0):
    """The same motion in a rig whose joints' axes, and so its OFFSETs, are turned at random: at rest no person."""
    count = len(bvh.names)
    S = matrix_from_axis_angle(np.random.default_rng(seed).normal(0, 2, (count, 3)))
    world = bvh.world_rotations() @ S
    local, offsets = world.copy(), bvh.offsets.copy()
    for j, parent in enumerate(bvh.parents):
        if parent >= 0:
            local[:, j] = np.swapaxes(world[:, parent], -1, -2) @ world[:, j]
            offsets[j] = S[parent].T @ bvh.offsets[j]
    return dataclasses.replace(bvh, rotations=local, offsets=offsets)


def write_parsed(path, bvh):
    """A parsed file as text again."""
    children = {j: [k for k, p in enumerate(bvh.parents) if p == j] for j in range(-1, len(bvh.names))}
    lines, order = ["HIERARCHY"], []

    def joint(j):
        order.append(j)
        lines.extend([f"{'JOINT' if bvh.parents[j] >= 0 else 'ROOT'} {bvh.names[j]}", "{"])
        lines.append("OFFSET " + " ".join(f"{v:.9f}" for v in bvh.offsets[j]))
        places = "6 Xposition Yposition Zposition" if bvh.parents[j] < 0 else "3"
        lines.append(f"CHANNELS {places} Zrotation Xrotation Yrotation")
        for child in children[j]:
            joint(child)
        lines.append("}")

    joint(children[-1][0])
    angles = zxy_degrees(bvh.rotations)[:, order].reshape(len(bvh.root), -1)
    lines += ["MOTION", f"Frames: {len(bvh.root)}", f"Frame Time: {1 / bvh.fps:.8f}"]
    lines += [" ".join(f"{v:.9f}" for v in [*root, *row]) for root, row in zip(bvh.root, angles, strict=True)]
    Path(path).write_text("\n".join(lines) + "\n")


def test_offsets_that_draw_no_person_are_understood_by_the_first_frame(tmp_path):
    angles = random_angles(6)
    angles[0] = 0  # the first frame stands in the rest pose
    root = np.stack([np.linspace(0, 50, 6), np.full(6, 95.0), np.zeros(6)], 1)
    write_bvh(tmp_path / "plain.bvh", angles, root)
    write_parsed(tmp_path / "odd.bvh", scrambled(read_bvh(tmp_path / "plain.bvh")))
    expected = read_motion(tmp_path / "plain.bvh")
    odd = read_motion(tmp_path / "odd.bvh", rest="first-frame")
    # 1e-5 rad: nine digits of degrees through thirty products
    there, here = (matrix_from_axis_angle(m.poses.astype(float)) for m in (expected, odd))
    np.testing.assert_allclose(here, there, atol=1e-5)
    np.testing.assert_allclose(odd.trans, expected.trans, atol=1e-5)
    assert np.abs(matrix_from_axis_angle(read_motion(tmp_path / "odd.bvh").poses.astype(float)) - there).max() > 0.5
    plain = read_motion(tmp_path / "plain.bvh", rest="first-frame")
    np.testing.assert_allclose(plain.poses, expected.poses, atol=1e-6)
    with pytest.raises(UserError, match="rest=second: choose from offsets, first-frame"):
        read_motion(tmp_path / "plain.bvh", rest="second")


@pytest.mark.parametrize(
    ("name", "side", "what"),
    [
        ("mixamorig:LeftUpLeg", "left", "upleg"), ("lThigh", "left", "thigh"), ("rShldr", "right", "shldr"),
        ("thigh.L", "left", "thigh"), ("upperarm_r", "right", "upperarm"), ("Bip01 L Thigh", "left", "thigh"),
        ("Hips", "", "hips"), ("LowerBack", "", "lowerback"), ("Character1_RightHand", "right", "hand"),
        ("Root", "", "root"), ("rib", "", "rib"), ("LHipJoint", "left", "hipjoint"), ("leftFoot", "left", "foot"),
        ("l_knee", "left", "knee"), ("RightHandThumb1", "right", "handthumb1"),
    ],
)  # fmt: skip
def test_sides_and_prefixes_are_told_from_names(name, side, what):
    assert split_name(name) == (side, what)


def test_a_shoulder_is_a_collar_bone_or_an_upper_arm_by_its_company():
    def matched(*names):
        return {joint: names[j] for joint, j in match_rig(list(names), None).items()}

    mixamo = matched("Hips", "LeftShoulder", "LeftArm", "LeftForeArm")
    assert (mixamo["left_collar"], mixamo["left_shoulder"]) == ("LeftShoulder", "LeftArm")
    other = matched("Hips", "LeftCollar", "LeftShoulder", "LeftElbow", "LHipJoint", "LeftHip", "LeftKnee")
    assert (other["left_collar"], other["left_shoulder"]) == ("LeftCollar", "LeftShoulder")
    assert (other["left_hip"], other["left_knee"]) == ("LeftHip", "LeftKnee")
    assert "left_collar" not in matched("Hips", "LeftShoulder", "LeftElbow")


def test_a_mapping_file_names_the_joints_of_a_foreign_rig(tmp_path):
    foreign = {name: f"bone{j:02d}" for j, (name, _, _) in enumerate(MIXAMO)}
    angles = random_angles(3)
    write_bvh(tmp_path / "known.bvh", angles, np.zeros((3, 3)))
    write_bvh(tmp_path / "foreign.bvh", angles, np.zeros((3, 3)), rename=foreign)
    with pytest.raises(UserError, match=r"foreign\.bvh.*left_hip.*mapping"):
        read_motion(tmp_path / "foreign.bvh")
    known = read_bvh(tmp_path / "known.bvh")
    table = {joint: foreign[known.names[j]] for joint, j in match_rig(known.names, known.parents).items()}
    (tmp_path / "map.json").write_text(json.dumps(table))
    mine = read_motion(tmp_path / "foreign.bvh", mapping=str(tmp_path / "map.json"))
    np.testing.assert_array_equal(mine.poses, read_motion(tmp_path / "known.bvh").poses)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "must hold an object"),
        ('{"left_hipp": "Hips"}', "unknown joint 'left_hipp'.*did you mean 'left_hip'"),
        ('{"left_hip": "LeftUpleg"}', "no 'LeftUpleg' for left_hip.*did you mean 'LeftUpLeg'"),
    ],
)
def test_a_faulty_mapping_file_is_named(tmp_path, text, message):
    write_bvh(tmp_path / "a.bvh", np.zeros((1, len(MIXAMO), 3)), [[0, 0, 0]])
    (tmp_path / "map.json").write_text(text)
    with pytest.raises(UserError, match=r"map\.json.*" + message):
        read_motion(tmp_path / "a.bvh", mapping=str(tmp_path / "map.json"))


FAULTS = {
    "no hierarchy": (lambda t: "hello\n" + t, "not a BVH file"),
    "empty": (lambda t: "", "not a BVH file"),
    "cut in the hierarchy": (lambda t: t[: t.index("MOTION") - 40], "ends early"),
    "cut in the motion": (lambda t: t.rstrip().rsplit(" ", 5)[0], "cut short"),
    "no frames": (lambda t: t.replace("Frames: 2", "Frames: 0"), "at least 1"),
    "frames are a word": (lambda t: t.replace("Frames: 2", "Frames: two"), "'two' is not a number"),
    "no frame time": (lambda t: t.replace("Frame Time: ", "Frame Time: 0 "), "positive"),
    "an unknown channel": (lambda t: t.replace("Zrotation", "Wrotation", 1), "CHANNELS needs"),
    "an offset of two": (lambda t: t.replace("OFFSET 0.000000 95.000000 0.000000", "OFFSET 0 95"), "OFFSET needs"),
    "a NaN": (lambda t: t.rstrip().rsplit(" ", 1)[0] + " nan\n", "NaN .* at frame 1"),
    "a word among the numbers": (lambda t: t.rstrip().rsplit(" ", 1)[0] + " x\n", "not a number"),
    "a stray word": (lambda t: t.replace("JOINT Spine\n", "BONE Spine\n"), "'BONE' is not a word"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_bvh_is_one_sentence_with_file_and_place(tmp_path, fault):
    write_bvh(tmp_path / "a.bvh", np.zeros((2, len(MIXAMO), 3)), np.zeros((2, 3)))
    change, message = FAULTS[fault]
    (tmp_path / "a.bvh").write_text(change((tmp_path / "a.bvh").read_text()))
    with pytest.raises(UserError, match=message) as raised:
        read_motion(tmp_path / "a.bvh")
    assert "a.bvh" in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("options", "message"), [({"up": "w"}, "up=w"), ({"units": "km"}, "units=km"), ({"fps": -1}, "fps=-1")]
)
def test_wrong_options_of_a_bvh_list_the_choices(tmp_path, options, message):
    write_bvh(tmp_path / "a.bvh", np.zeros((1, len(MIXAMO), 3)), [[0, 0, 0]])
    with pytest.raises(UserError, match=message):
        read_motion(tmp_path / "a.bvh", **options)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["dab", "jumping", "jumping_jacks", "wave_hello", "zombie"])
def test_the_shared_clips_are_upright_people(name):
    path = SHARED / f"{name}.bvh"
    if not path.exists():
        pytest.skip(f"{path} is absent")
    motion = read_motion(path)
    body = free_body()
    _, rest = body.shaped(None)
    motion = scaled_to_legs(motion, body.joint_names, rest)
    T = joint_transforms(motion.poses.astype(np.float64), rest, body.parents)
    place = {n: T[:, SMPLH.index(n), :3, 3] + motion.trans for n in ("head", "pelvis", "left_ankle", "right_ankle")}
    assert (place["head"][:, 1] > place["pelvis"][:, 1]).mean() > 0.98
    lowest = np.minimum(place["left_ankle"][:, 1], place["right_ankle"][:, 1])
    assert -0.05 < np.quantile(lowest, 0.05) < 0.2  # metres: on the floor that the capture was made on
    # toes lie before the heels, in the direction that the pelvis faces
    foot = T[:, SMPLH.index("left_foot"), :3, 3] - T[:, SMPLH.index("left_ankle"), :3, 3]
    assert ((foot * T[:, 0, :3, 2]).sum(-1) > 0).mean() > 0.8


@pytest.mark.shared
@pytest.mark.parametrize("name", ["dab", "jumping", "jumping_jacks", "wave_hello", "zombie"])
def test_the_first_frame_of_the_shared_clips_may_be_their_rest_pose(name, tmp_path):
    path = SHARED / f"{name}.bvh"
    if not path.exists():
        pytest.skip(f"{path} is absent")
    offsets, first = read_motion(path), read_motion(path, rest="first-frame")
    middle = [SMPLH.index(n) for n in ("spine1", "spine2", "spine3", "neck", "head")]
    # 1e-6: the person stands at rest in the first frame
    assert np.abs(matrix_from_axis_angle(first.poses[0, middle].astype(float)) - np.eye(3)).max() < 1e-6
    body = free_body()
    _, rest = body.shaped(None)
    limbs = [joint_transforms(m.poses.astype(np.float64), rest, body.parents)[..., :3, 3] for m in (offsets, first)]
    # whatever the rest pose, limbs point where the rig's do; who stands at rest faces +z, so the heading may differ
    pairs = [(SMPLH.index(f"{s}_{a}"), SMPLH.index(f"{s}_{b}")) for s in ("left", "right") for a, b in NEXT.items()]
    mine, theirs = (np.concatenate([directions(places, *pair) for pair in pairs]) for places in limbs)
    U, _, Vt = np.linalg.svd(theirs.T @ mine)
    turn = U @ Vt
    np.testing.assert_allclose(turn, np.round(turn), atol=1e-3)  # a quarter, a half or no turn ...
    assert turn[1, 1] == pytest.approx(1, abs=1e-5)  # ... about the vertical
    angle = np.degrees(np.arccos(np.clip((theirs * (mine @ turn.T)).sum(-1), -1, 1)))
    assert angle.max() < 0.1  # float32 axis-angle
    # the odd twin of the clip, whose OFFSETs draw nothing, is read as the same motion
    write_parsed(tmp_path / "odd.bvh", scrambled(read_bvh(path)))
    odd = read_motion(tmp_path / "odd.bvh", rest="first-frame")
    there, here = (matrix_from_axis_angle(m.poses.astype(float)) for m in (first, odd))
    np.testing.assert_allclose(here, there, atol=1e-4)  # nine digits of degrees through sixty products
    np.testing.assert_allclose(odd.trans, first.trans, atol=1e-4)


@pytest.mark.shared
def test_the_upstream_test_pose_reads_as_torch_reads_it():
    path = SHARED / "upstream_test_pose_smpl_parms.pth"
    if not path.exists():
        pytest.skip(f"{path} is absent")
    mine, theirs = load_torch(path), torch.load(path, weights_only=True)
    for key, value in theirs.items():
        np.testing.assert_array_equal(mine[key], value.numpy())


def test_no_warning_is_raised_by_a_plain_file(tmp_path):
    np.savez(tmp_path / "a.npz", poses=numbers(2, 66), mocap_framerate=30)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_motion(tmp_path / "a.npz")
