"""One short motion in the files that other tools write (../shared/cases): each is read as it is meant, or refused by a
sentence that says what it is."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import places
import pytest
from bvh_rigs import NEXT, directions
from make_bundle import free_body
from motion_files import assert_same_rotations, rotations_of

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix
from gavatar_runtime.motions import read_motion
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.skeletons import SMPLH

CASES = places.SHARED / "cases"
pytestmark = [
    pytest.mark.shared,
    pytest.mark.skipif(not CASES.is_dir(), reason=f"{CASES} is absent: the files are not part of the package"),
]


@dataclasses.dataclass(frozen=True)
class Read:
    """options: given to read it. fps: that it then has. walks: whether trans is that of the truth. notes: words that
    its notes must have, a note each."""

    options: dict = dataclasses.field(default_factory=dict)
    fps: float = 30.0
    walks: bool = True
    notes: tuple[str, ...] = ()


RATE = "states no frame rate: 30 a second"
FIELDS = {
    "truth.npz": Read(),
    "gvhmr_hmr4d_results.pt": Read(notes=(RATE,)),
    "wham_output.pkl": Read(notes=(r"2 persons: 0 is taken", RATE)),
    "phalp_demo.pkl": Read(walks=False, notes=("made-up focal length", RATE)),
    "3dpw.pkl": Read(notes=("2 persons: 0 is taken",)),
    "slahmr_world_results.npz": Read(notes=(RATE,)),
    "motionx.npy": Read(),
    "matrices.npz": Read(),
    "aist_in_npz.npz": Read(fps=60.0),
    "six_d.npz": Read({"rotations": "6d"}),
}
RIGS = {
    "truth.bvh": Read(),
    "fixed_root.bvh": Read(),
    "prefix.bvh": Read(),
    "frame_time_zero.bvh": Read({"fps": 30}),
    "no_blank_after_colon.bvh": Read(),
    "utf16.bvh": Read(),
}
ODD_REST = {"bones_along_x.bvh": Read(notes=("rest pose anatomy: the OFFSETs draw nobody",))}
REFUSED = {
    "frame_time_zero.bvh": r"Frame Time .*`fps=30`",
    "humanml3d_joints.npy": r"positions of 22 joints, not rotations.*smpl_params\.npy",
    "positions.npz": r"poses holds positions of 22 joints, not rotations",
    "six_d.npz": r"6D, .*`rotations=6d` or 6d-rows",
    "rate_is_frame_count.npz": r"2000 frames a second, as many as it has frames.*`fps=30`",
    "smplifyx_vposer.pkl": r"VPoser's code of 32 numbers.*SMPLify-X.*vposer\.decode",
}


def read(name: str, case: Read) -> Motion:
    motion = read_motion(CASES / name, **case.options)
    assert motion.fps == pytest.approx(case.fps, abs=1e-3)
    assert len(motion.notes) == len(case.notes), motion.notes
    for words, note in zip(case.notes, motion.notes, strict=True):
        assert words in note
    return motion


def assert_same_walk(motion: Motion, truth: Motion) -> None:
    # 1e-4 m: float32 after a division
    np.testing.assert_allclose(motion.trans - motion.trans[0], truth.trans - truth.trans[0], atol=1e-4)


REASONS = {
    "humanml3d_joints.npy": "joint positions",
    "positions.npz": "joint positions under the name `poses`",
    "rate_is_frame_count.npz": "2000 frames a second, as many as it has frames",
    "smplifyx_vposer.pkl": "a code of VPoser",
    "frame_time_zero.bvh": "no rate",
    "six_d.npz": "6D, columns or rows",
}


def outcome(name: str) -> str:
    """What happens with a case, as the page of motions has it."""
    case = {**FIELDS, **RIGS, **ODD_REST}.get(name)
    option = (
        "" if case is None else "".join(f" with `--set motion.{key}={value}`" for key, value in case.options.items())
    )
    refused = f"refused: {REASONS[name]}" if name in REFUSED else ""
    if case is None:
        return refused
    where = "equal to the truth within 1e-4 rad"
    if name in ODD_REST:
        where = "limbs within 5 degrees of the truth, twist within 15"
    told = "" if case.walks else "; stays in place, with a note"
    return f"{refused + '; ' if refused else ''}{where}{option}{told}"


def test_the_page_of_motions_has_the_same_table():
    page = (places.ROOT / "docs/reference/motions.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `([^`|]+)` \| (.+) \|$", page, re.M))
    names = {*FIELDS, *RIGS, *ODD_REST, *REFUSED}
    assert {name: rows.get(name) for name in names} == {name: outcome(name) for name in names}


def test_every_case_is_in_the_tables():
    files = {path.name for path in CASES.iterdir() if path.suffix != ".md"}
    assert files == {*FIELDS, *RIGS, *ODD_REST, *REFUSED}


@pytest.mark.parametrize("name", FIELDS)
def test_files_that_hold_rotations_turn_every_joint_as_the_truth_does(name):
    truth, motion = read_motion(CASES / "truth.npz"), read(name, FIELDS[name])
    assert_same_rotations(motion, truth.poses)
    if FIELDS[name].walks:
        assert_same_walk(motion, truth)
        # the centimetres of AIST++ become metres: nobody stands 90 m high
        np.testing.assert_allclose(motion.trans[:, 1], truth.trans[:, 1], atol=1e-4)
    else:
        assert not motion.trans.any()


@pytest.mark.parametrize("name", RIGS)
def test_rigs_that_draw_a_person_move_as_the_truth_does(name):
    truth, motion = read_motion(CASES / "truth.bvh"), read(name, RIGS[name])
    assert_same_rotations(motion, truth.poses)
    assert_same_walk(motion, truth)
    assert motion.leg_length == pytest.approx(truth.leg_length)


def test_the_rig_walks_and_turns_as_the_poses_of_the_truth_do():
    rig, poses = read_motion(CASES / "truth.bvh"), read_motion(CASES / "truth.npz")
    np.testing.assert_allclose(rotations_of(rig, 1), rotations_of(poses, 1), atol=1e-4)
    heading = rotations_of(rig, 1)[-1, 0, :, 2]
    assert np.degrees(np.arctan2(heading[0], heading[2])) == pytest.approx(120, abs=0.1)  # as its README says
    assert np.linalg.norm(np.diff(poses.trans, axis=0), axis=1).sum() == pytest.approx(2.18, abs=0.1)


@pytest.mark.parametrize("name", ODD_REST)
def test_rigs_that_draw_nobody_move_as_the_truth_does(name):
    truth, motion = read_motion(CASES / "truth.bvh"), read(name, ODD_REST[name])
    body = free_body()
    _, rest = body.shaped(None)
    mine, theirs = (joint_transforms(m.poses.astype(np.float64), rest, body.parents) for m in (motion, truth))
    for side in ("left", "right"):
        for part, following in NEXT.items():
            pair = SMPLH.index(f"{side}_{part}"), SMPLH.index(f"{side}_{following}")
            cosine = (directions(mine[..., :3, 3], *pair) * directions(theirs[..., :3, 3], *pair)).sum(-1)
            assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 5, (side, part)
    turn = np.swapaxes(theirs[..., :3, :3], -1, -2) @ mine[..., :3, :3]
    assert np.degrees(np.linalg.norm(axis_angle_from_matrix(turn), axis=-1))[:, :22].max() < 15
    assert_same_walk(motion, truth)


@pytest.mark.parametrize("name", REFUSED)
def test_files_without_rotations_or_with_senseless_numbers_are_refused_with_the_way_out(name):
    with pytest.raises(UserError, match=REFUSED[name]) as raised:
        read_motion(CASES / name)
    assert name in str(raised.value)
    assert "\n" not in str(raised.value)


def test_the_second_person_of_a_file_can_be_asked_for():
    assert len(read_motion(CASES / "wham_output.pkl", person=4)) == 7
    assert len(read_motion(CASES / "3dpw.pkl", person="1")) == 17
    with pytest.raises(UserError, match=r"no person '2': choose from: 0, 4"):
        read_motion(CASES / "wham_output.pkl", person=2)
