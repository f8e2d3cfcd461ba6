"""Rest poses of BVH: OFFSETs that draw nobody, first frames, and what anatomy tells."""

from __future__ import annotations

import re

import numpy as np
import places
import pytest
from bvh_rigs import (
    MIXAMO,
    NEXT,
    Z_UP,
    bones_along,
    directions,
    in_world,
    random_angles,
    scrambled,
    write_bvh,
    write_parsed,
)
from make_bundle import free_body

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.bvh_file import read_bvh
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.source import motion_source
from gavatar_runtime.values.skeletons import SMPLH


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
    drawn = read_motion(tmp_path / "odd.bvh", rest="offsets")
    assert np.abs(matrix_from_axis_angle(drawn.poses.astype(float)) - there).max() > 0.5
    plain = read_motion(tmp_path / "plain.bvh", rest="first-frame")
    np.testing.assert_allclose(plain.poses, expected.poses, atol=1e-6)
    with pytest.raises(UserError, match="`rest=second`: choose from auto, offsets, first-frame, anatomy"):
        read_motion(tmp_path / "plain.bvh", rest="second")


@pytest.mark.shared
@pytest.mark.parametrize("name", ["dab", "jumping", "jumping_jacks", "wave_hello", "zombie"])
def test_the_first_frame_of_the_shared_clips_may_be_their_rest_pose(name, tmp_path):
    path = places.SHARED / "motions" / f"{name}.bvh"
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


def natural(frames=40, seed=0):
    """(T, J, 3) degrees about Z, X, Y of somebody who stands, walks on the spot and moves the arms: hinges bend as
    people's do, the first frame is no rest pose."""
    rng, phase = np.random.default_rng(seed), np.linspace(0.5, 2 * np.pi, frames)
    names = [name for name, _, _ in MIXAMO]
    angles = np.zeros((frames, len(names), 3))

    def set_(name, **degrees):
        for axis, value in degrees.items():
            angles[:, names.index(name), "zxy".index(axis)] = value

    set_("Hips", y=20 * np.sin(phase / 2), x=3)
    set_("Spine1", y=8 * np.sin(phase), z=3 * np.cos(phase))
    set_("Head", y=10 * np.sin(phase), x=4)
    for side, sign in (("Left", 1), ("Right", -1)):
        swing = np.sin(phase + (np.pi if sign < 0 else 0))
        set_(f"{side}Arm", z=-sign * (70 + 5 * swing), y=-sign * 12 * swing)
        set_(f"{side}ForeArm", y=-sign * (25 + 25 * swing))
        set_(f"{side}UpLeg", x=-20 * np.maximum(swing, 0), z=sign * 3)
        set_(f"{side}Leg", x=30 * np.maximum(swing, 0))
        set_(f"{side}Foot", x=5 * rng.normal(0, 1))
    return angles


def difference(mine, theirs):
    """Degrees: the largest between limbs of two motions on the free body, and (J,) between joints' orientations."""
    body = free_body()
    _, rest = body.shaped(None)
    a, b = (joint_transforms(m.poses.astype(np.float64), rest, body.parents) for m in (mine, theirs))
    limbs = 0.0
    for side in ("left", "right"):
        for part, following in NEXT.items():
            pair = SMPLH.index(f"{side}_{part}"), SMPLH.index(f"{side}_{following}")
            cosine = (directions(a[..., :3, 3], *pair) * directions(b[..., :3, 3], *pair)).sum(-1)
            limbs = max(limbs, np.degrees(np.arccos(np.clip(cosine, -1, 1))).max())
    turn = np.swapaxes(b[..., :3, :3], -1, -2) @ a[..., :3, :3]
    return limbs, np.degrees(np.linalg.norm(axis_angle_from_matrix(turn), axis=-1)).max(0)


def assert_as_the_t_pose_rig(mine, theirs):
    limbs, joints = difference(mine, theirs)
    assert limbs < 5
    worst = {name: round(float(angle), 1) for name, angle in zip(SMPLH[:22], joints, strict=False) if angle > 15}
    assert worst == {}
    np.testing.assert_allclose(mine.trans, theirs.trans, atol=1e-4)


ODD_RIGS = {
    "bones along x": {"axis": "x"},
    "bones along x, the right side's against it": {"axis": "x", "mirrored": True},
    "bones along y": {"axis": "y"},
    "bones along z, mirrored, hinges about another axis": {"axis": "z", "mirrored": True, "roll": 90},
    "bones along y, turned about themselves": {"axis": "y", "roll": 37},
}
ROOT = np.stack([np.linspace(0, 100, 40), 95 + np.cos(np.arange(40)), np.linspace(0, 30, 40)], 1)


@pytest.mark.parametrize("rig", ODD_RIGS)
@pytest.mark.parametrize("world", ["y-up", "z-up"])
def test_rigs_whose_offsets_draw_nobody_move_as_the_t_pose_rig_does(tmp_path, rig, world):
    write_bvh(tmp_path / "plain.bvh", natural(), ROOT)
    odd = bones_along(read_bvh(tmp_path / "plain.bvh"), **ODD_RIGS[rig])
    write_parsed(tmp_path / "odd.bvh", odd if world == "y-up" else in_world(odd, Z_UP))
    source = motion_source(tmp_path / "odd.bvh")
    assert_as_the_t_pose_rig(source.load(), read_motion(tmp_path / "plain.bvh"))
    assert source.facts["rest pose"].startswith("anatomy: the OFFSETs draw nobody who stands")


@pytest.mark.parametrize("seed", range(3))
def test_axes_at_random_make_no_difference(tmp_path, seed):
    write_bvh(tmp_path / "plain.bvh", natural(seed=seed), ROOT)
    write_parsed(tmp_path / "odd.bvh", scrambled(read_bvh(tmp_path / "plain.bvh"), seed))
    odd = read_motion(tmp_path / "odd.bvh")
    assert_as_the_t_pose_rig(odd, read_motion(tmp_path / "plain.bvh"))
    assert any("rest pose anatomy" in note and "`rest`" in note for note in odd.notes)


def test_anatomy_finds_the_same_pose_where_the_offsets_draw_it(tmp_path):
    write_bvh(tmp_path / "plain.bvh", natural(), ROOT)
    assert_as_the_t_pose_rig(read_motion(tmp_path / "plain.bvh", rest="anatomy"), read_motion(tmp_path / "plain.bvh"))


@pytest.mark.parametrize("lowered", [0.0, 40.0, 85.0])
def test_offsets_that_draw_a_person_are_taken_and_said_so(tmp_path, lowered):
    write_bvh(tmp_path / "plain.bvh", natural(), ROOT, lowered=lowered)
    source = motion_source(tmp_path / "plain.bvh")
    assert source.load().notes == ()
    assert source.facts["rest pose"] == "offsets: the OFFSETs draw a person who stands"
    assert motion_source(tmp_path / "plain.bvh", rest="offsets").load().notes == ()


def test_a_t_pose_before_the_motion_is_taken_and_the_way_it_faces_is_the_files(tmp_path):
    angles = natural()
    angles[0], angles[:, 0, 2] = 0, 30  # turned by 30 degrees, at the T-pose too
    write_bvh(tmp_path / "plain.bvh", angles, ROOT)
    write_parsed(tmp_path / "odd.bvh", scrambled(read_bvh(tmp_path / "plain.bvh")))
    source = motion_source(tmp_path / "odd.bvh")
    limbs, joints = difference(source.load(), read_motion(tmp_path / "plain.bvh"))
    assert source.facts["rest pose"].startswith("first-frame")
    assert limbs < 0.1
    # a toe hangs down from its ankle in this rig's OFFSETs as in its T-pose; 0.5: float32, hips level within that
    assert joints.max() < 0.5


@pytest.mark.parametrize("frames", [1, 2])
def test_a_frame_or_two_are_enough_for_the_directions_of_limbs(tmp_path, frames):
    write_bvh(tmp_path / "plain.bvh", natural()[:frames], ROOT[:frames])
    write_parsed(tmp_path / "odd.bvh", bones_along(read_bvh(tmp_path / "plain.bvh"), "x", mirrored=True))
    limbs, _ = difference(read_motion(tmp_path / "odd.bvh"), read_motion(tmp_path / "plain.bvh"))
    assert limbs < 5


def test_straight_limbs_are_turned_by_feet_and_hang_without_a_twist(tmp_path):
    """Nothing bends: feet ahead of ankles tell the legs, and arms are brought down the shortest way."""
    angles = natural()
    names = [name for name, _, _ in MIXAMO]
    for side in ("Left", "Right"):
        for part in ("Leg", "ForeArm", "UpLeg"):
            angles[:, names.index(f"{side}{part}")] = 0
    write_bvh(tmp_path / "plain.bvh", angles, ROOT)
    write_parsed(tmp_path / "odd.bvh", scrambled(read_bvh(tmp_path / "plain.bvh")))
    assert_as_the_t_pose_rig(read_motion(tmp_path / "odd.bvh"), read_motion(tmp_path / "plain.bvh"))


def test_hips_and_shoulders_in_one_place_are_refused(tmp_path):
    write_bvh(tmp_path / "plain.bvh", natural(3), ROOT[:3])
    text = (tmp_path / "plain.bvh").read_text()
    (tmp_path / "flat.bvh").write_text(re.sub(r"OFFSET [-\d. ]+", "OFFSET 0 0 0", text))
    with pytest.raises(UserError, match=r"flat\.bvh"):
        read_motion(tmp_path / "flat.bvh")


@pytest.mark.shared
@pytest.mark.parametrize("name", ["dab", "jumping", "jumping_jacks", "wave_hello", "zombie"])
def test_real_clips_in_odd_rigs_keep_their_limbs_and_nearly_their_twist(name, tmp_path):
    path = places.SHARED / "motions" / f"{name}.bvh"
    if not path.exists():
        pytest.skip(f"{path} is absent")
    write_parsed(tmp_path / "odd.bvh", bones_along(read_bvh(path), "x", mirrored=True))
    limbs, joints = difference(read_motion(tmp_path / "odd.bvh"), read_motion(path))
    assert limbs < 0.1  # float32 axis-angle
    hinged = [SMPLH.index(f"{s}_{p}") for s in ("left", "right") for p in ("hip", "knee", "shoulder", "elbow")]
    assert joints[[0, *hinged]].max() < 15
    wrists = [SMPLH.index(f"{side}_wrist") for side in ("left", "right")]
    # the actor of the jumping jacks holds the left hand turned throughout: nothing tells it from a rest pose
    assert joints[wrists[1 if name == "jumping_jacks" else 0 :]].max() < 20
