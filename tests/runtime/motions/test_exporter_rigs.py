"""One motion in the rigs that programs export: each moves as the plain T-pose rig does, whatever its names and axes."""

from __future__ import annotations

import numpy as np
import pytest
from bvh_rigs import write_bvh, write_parsed
from exporter_rigs import EXPORTERS, renamed, under
from test_rest_poses import ROOT, assert_as_the_t_pose_rig, difference, natural

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.bvh_file import read_bvh
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.source import motion_source
from gavatar_runtime.rigs.rig_names import match_rig


@pytest.fixture
def plain(tmp_path):
    angles = natural()
    angles[:, 0, 2] += np.linspace(0, 90, len(angles))  # a turn, so that none stands still
    write_bvh(tmp_path / "plain.bvh", angles, ROOT)
    return tmp_path / "plain.bvh"


@pytest.mark.parametrize("exporter", EXPORTERS)
def test_every_exporters_rig_moves_as_the_t_pose_rig_does(plain, tmp_path, exporter):
    rig = EXPORTERS[exporter]
    changed = renamed(rig.change(read_bvh(plain)), rig.table, rig.prefix)
    write_parsed(tmp_path / "rig.bvh", changed)
    mapping = match_rig(changed.names, changed.parents)
    assert {"neck", "head", "left_wrist", "right_foot", "left_collar"} <= set(mapping)
    source = motion_source(tmp_path / "rig.bvh")
    assert_as_the_t_pose_rig(source.load(), read_motion(plain))
    assert source.facts["rest pose"].split(":")[0] in ("offsets", "anatomy")


def test_a_motionless_root_is_passed_over_whatever_its_name(plain, tmp_path):
    for name in ("World", "Armature", "root_joint", "Hips_root", "骨"):
        write_parsed(tmp_path / "rig.bvh", under(read_bvh(plain), name))
        motion = read_motion(tmp_path / "rig.bvh")
        limbs, joints = difference(motion, read_motion(plain))
        # float32 axis-angle of products of nine-digit angles
        assert limbs < 0.1
        assert joints.max() < 0.1
        np.testing.assert_allclose(motion.trans, read_motion(plain).trans, atol=1e-4)


def lines_of(path):
    head, motion = path.read_text().split("MOTION\n")
    rows = [line.split() for line in motion.splitlines()[2:]]
    return head, rows


def put(path, head, rows, rate="0.0333333"):
    body = "\n".join(" ".join(row) for row in rows)
    path.write_text(f"{head}MOTION\nFrames: {len(rows)}\nFrame Time: {rate}\n{body}\n")
    return path


def test_angles_in_radians_are_noted_and_read_when_they_are_said_to_be_such(plain, tmp_path):
    head, rows = lines_of(plain)
    rows = [row[:3] + [f"{np.radians(float(v)):.9f}" for v in row[3:]] for row in rows]
    path = put(tmp_path / "radians.bvh", head, rows)
    notes = read_motion(path).notes
    assert any("if these are radians, not degrees, `angles=radians` reads them" in note for note in notes)
    motion = read_motion(path, angles="radians")
    assert motion.notes == ()
    np.testing.assert_allclose(motion.poses, read_motion(plain).poses, atol=1e-4)
    with pytest.raises(UserError, match="`angles=grad`: choose from degrees, radians"):
        read_motion(path, angles="grad")


def test_what_turns_no_limb_is_refused_and_what_walks_nowhere_noted(plain, tmp_path):
    head, rows = lines_of(plain)
    bare = "\n".join(line for line in head.split("\n") if "CHANNELS 3" not in line)
    with pytest.raises(UserError, match="the limbs have no rotation channels"):
        read_motion(put(tmp_path / "a.bvh", bare, [row[:6] for row in rows]))
    places = head.replace("CHANNELS 3 Zrotation Xrotation Yrotation", "CHANNELS 3 Xposition Yposition Zposition")
    with pytest.raises(UserError, match="positions of joints and no rotations of its limbs"):
        read_motion(put(tmp_path / "a.bvh", places, rows))
    still = head.replace("CHANNELS 6 Xposition Yposition Zposition", "CHANNELS 3")
    motion = read_motion(put(tmp_path / "a.bvh", still, [row[3:] for row in rows]))
    assert motion.notes == ("no joint has position channels: the person stays in place",)


def test_positions_in_another_unit_than_the_offsets_and_angles_beyond_sense_are_told(plain, tmp_path):
    head, rows = lines_of(plain)
    far = [[f"{float(v) * 1000:.3f}" for v in row[:3]] + row[3:] for row in rows]
    notes = read_motion(put(tmp_path / "a.bvh", head, far)).notes
    assert any("another unit than the OFFSETs; `units=cm`" in note for note in notes)
    with pytest.raises(UserError, match=r"turns a joint by 1e\+30 degrees: these are no angles"):
        read_motion(put(tmp_path / "a.bvh", head, [[*row[:-1], "1e30"] for row in rows]))


@pytest.mark.parametrize("between", [", ", ";", " ; ", ",  "])
def test_numbers_may_stand_between_commas_and_semicolons(plain, tmp_path, between):
    head, rows = lines_of(plain)
    path = put(tmp_path / "a.bvh", head, [[between.join(row)] for row in rows])
    np.testing.assert_allclose(read_motion(path).poses, read_motion(plain).poses, atol=1e-6)


def test_a_frame_alone_needs_no_rate(plain, tmp_path):
    head, rows = lines_of(plain)
    assert read_motion(put(tmp_path / "a.bvh", head, rows[:1], rate="0")).fps == 30
    with pytest.raises(UserError, match="Frame Time"):
        read_motion(put(tmp_path / "a.bvh", head, rows[:2], rate="0"))


def test_a_joint_that_hangs_from_another_limb_is_noted(plain, tmp_path):
    bvh = read_bvh(plain)
    bvh.parents[bvh.names.index("LeftForeArm")] = bvh.names.index("Spine2")
    write_parsed(tmp_path / "a.bvh", bvh)
    notes = read_motion(tmp_path / "a.bvh", rest="offsets").notes
    assert any("'LeftForeArm', taken for left_elbow, does not hang from" in n and "`mapping=FILE`" in n for n in notes)
