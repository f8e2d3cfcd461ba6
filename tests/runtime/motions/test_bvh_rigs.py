"""BVH retargeted by joint names: limbs, walk, units, names, mappings."""

from __future__ import annotations

import json

import numpy as np
import places
import pytest
from bvh_rigs import MIXAMO, NEXT, RIGS, directions, random_angles, write_bvh
from make_bundle import free_body

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.bvh_file import read_bvh
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.fitting import scaled_to_legs
from gavatar_runtime.rigs.rig_names import match_rig, split_name
from gavatar_runtime.values.skeletons import SMPLH


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
    path = places.SHARED / "motions" / f"{name}.bvh"
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
