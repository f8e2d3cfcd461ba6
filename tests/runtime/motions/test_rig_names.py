"""Joints of foreign rigs told by their names: sides, prefixes, separators, and the joint that is the pelvis."""

from __future__ import annotations

import numpy as np
import pytest
from bvh_rigs import MIXAMO, random_angles, write_bvh

from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.rigs.rig_names import bare_names, match_rig, split_name

PARTS = {
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase", "collar": "Shoulder", "shoulder": "Arm",
    "elbow": "ForeArm", "wrist": "Hand",
}  # fmt: skip
PARENTS = [next((j for j, (n, _, _) in enumerate(MIXAMO) if n == p), -1) for _, p, _ in MIXAMO]


@pytest.mark.parametrize(
    ("name", "side", "what"),
    [
        ("J_Bip_L_UpperLeg", "left", "upperleg"), ("CC_Base_R_Forearm", "right", "forearm"),
        ("DEF-thigh.L", "left", "thigh"), ("lfemur", "left", "femur"), ("rradius", "right", "radius"),
        ("LUArm", "left", "uarm"), ("Knee_R", "right", "knee"),
        ("jnt_left_up_leg", "left", "upleg"), ("left-up-leg", "left", "upleg"), ("Left Up Leg", "left", "upleg"),
        ("upper_leg.L.001", "left", "upperleg"), ("C_Neck_jnt", "", "neckjnt"), ("Head_M", "", "head"),
        ("rig|Hips", "", "hips"), ("Bip001-R-Thigh", "right", "thigh"), ("ribs", "", "ribs"), ("lung", "", "lung"),
        ("", "", ""), ("L", "", "l"), ("___", "", ""),
    ],
)  # fmt: skip
def test_more_sides_and_prefixes(name, side, what):
    assert split_name(name) == (side, what)


@pytest.mark.parametrize(
    "ways",
    [
        "Robot_{}", "Robot_A:{}", "my.rig.{}", "ns1|ns2|{}", "Robot{}", "{}_jnt", "Robot_{}_JNT", "avatar {}", "x-{}",
        "01_{}",
    ],
)  # fmt: skip
def test_what_most_names_begin_and_end_with_is_taken_off(ways):
    names = [name for name, _, _ in MIXAMO]
    assert bare_names([ways.format(name) for name in names]) == names
    others = [ways.format(name) if name not in ("Hips", "Head") else name for name in names]
    if ways not in ("Robot{}",):  # without a separator only what every name has is a prefix
        assert bare_names(others) == names


def test_a_side_is_no_prefix():
    names = ["Left_UpLeg", "Left_Leg", "Left_Foot", "Left_Arm"]
    assert bare_names(names) == names
    assert bare_names(["l_hip", "l_knee", "l_ankle", "l_toe"]) == ["l_hip", "l_knee", "l_ankle", "l_toe"]
    assert bare_names([]) == []
    assert bare_names(["Hips"]) == ["Hips"]


STYLES = {
    "Biped": ("Bip01 {} {}", ("L", "R"), ("Thigh", "Calf", "Foot", "Toe0", "Clavicle", "UpperArm", "Forearm", "Hand")),
    "Unreal": (
        "{1}_{0}", ("l", "r"), ("thigh", "calf", "foot", "ball", "clavicle", "upperarm", "lowerarm", "hand"),
    ),
    "Rokoko": ("{}{}", ("Left", "Right"), ("Thigh", "Shin", "Foot", "Toe", "Shoulder", "Arm", "ForeArm", "Hand")),
    "Bandai-Namco": (
        "{1}_{0}", ("L", "R"),
        ("UpperLeg", "LowerLeg", "Foot", "Toes", "Shoulder", "UpperArm", "LowerArm", "Hand"),
    ),
    "VRM": (
        "J_Bip_{}_{}", ("L", "R"),
        ("UpperLeg", "LowerLeg", "Foot", "ToeBase", "Shoulder", "UpperArm", "LowerArm", "Hand"),
    ),
    "SMPL": ("{}_{}", ("L", "R"), ("Hip", "Knee", "Ankle", "Foot", "Collar", "Shoulder", "Elbow", "Wrist")),
    "OptiTrack": ("Skeleton:{}{}", ("L", "R"), ("Thigh", "Shin", "Foot", "Toe", "Shoulder", "UArm", "FArm", "Hand")),
    "ASF": ("{}{}", ("l", "r"), ("femur", "tibia", "foot", "toes", "clavicle", "humerus", "radius", "hand")),
    "MakeHuman": (
        "{1}.{0}", ("L", "R"),
        ("upperleg01", "lowerleg01", "foot", "toe1", "clavicle", "upperarm01", "lowerarm01", "wrist"),
    ),
    "Maya": ("{1}_{0}", ("L", "R"), ("Hip", "Knee", "Ankle", "Toes", "Scapula", "Shoulder", "Elbow", "Wrist")),
    "hyphens": (
        "{}-{}", ("left", "right"), ("up-leg", "leg", "foot", "toe-base", "shoulder", "arm", "fore-arm", "hand"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("prefix", ["", "Robot_", "ns:"])
def test_the_names_of_many_rigs_are_known(tmp_path, style, prefix):
    form, sides, parts = STYLES[style]
    rename = {
        f"{side}{PARTS[joint]}": form.format(short, part)
        for side, short in zip(("Left", "Right"), sides, strict=True)
        for joint, part in zip(PARTS, parts, strict=True)
    }
    rename |= {"Hips": "Bip01" if style == "Biped" else "root"}
    names = [prefix + rename.get(name, name) for name, _, _ in MIXAMO]
    found = match_rig(names, PARENTS)
    for side in ("left", "right"):
        for joint, part in PARTS.items():
            mine = f"{side.capitalize()}{part}"
            assert found.get(f"{side}_{joint}") == [n for n, _, _ in MIXAMO].index(mine), (joint, names)
    angles, root = random_angles(3), np.zeros((3, 3))
    write_bvh(tmp_path / "a.bvh", angles, root)
    write_bvh(tmp_path / "b.bvh", angles, root, rename=rename, prefix=prefix)
    body = slice(0, 22)
    mine, theirs = (read_motion(tmp_path / f"{name}.bvh").poses[:, body] for name in ("b", "a"))
    np.testing.assert_allclose(mine, theirs, atol=1e-6)


def test_the_pelvis_is_where_both_legs_hang_from():
    names = ["World", "Mover", "Center", "LHip", "LKnee", "LAnkle", "RHip", "RKnee", "RAnkle", "Chest"]
    parents = [-1, 0, 1, 2, 3, 4, 2, 6, 7, 1]
    assert match_rig(names, parents)["pelvis"] == 2
    assert match_rig(names, None)["pelvis"] == 0
    assert match_rig(["a", "b"], [-1, 0])["pelvis"] == 0
    # CMU has a joint between pelvis and thigh
    cmu = ["Hips", "LHipJoint", "LeftUpLeg", "RHipJoint", "RightUpLeg"]
    assert match_rig(cmu, [-1, 0, 1, 0, 3])["pelvis"] == 0


def test_unknown_names_ask_for_a_mapping_by_the_option_as_it_is_written(tmp_path):
    foreign = {name: f"bone{j:02d}" for j, (name, _, _) in enumerate(MIXAMO)}
    write_bvh(tmp_path / "a.bvh", random_angles(2), np.zeros((2, 3)), rename=foreign)
    with pytest.raises(UserError, match=r"left_hip.*`mapping=FILE`"):
        read_motion(tmp_path / "a.bvh")
