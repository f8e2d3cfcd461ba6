"""The page's reader of .bvh, run by node: the joints of the player's, or a sentence that names the command."""

from __future__ import annotations

import shutil

import numpy as np
import places
import pytest
from bvh_rigs import MIXAMO, RIGS, random_angles, write_bvh, write_parsed
from exporter_rigs import EXPORTERS, renamed
from player_script import read_by_the_page, run

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.bvh_file import read_bvh
from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.motions.source import motion_source
from gavatar_runtime.rigs.rig_names import match_rig, split_name
from gavatar_runtime.web.look import StillLook, read_look

pytest.importorskip("onnx", reason="the hand-made networks need onnx")

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="no node here")

CLOSE = 2e-5  # metres of a joint: float32 angles of a dozen joints one after another
ROOT = np.stack([np.linspace(0, 100, 12), np.full(12, 95.0), np.zeros(12)], 1)
COMMAND = "gavatar-motion convert {} -o motion.npz"


@pytest.fixture(scope="module")
def avatar(static) -> Avatar:
    return Avatar(read_bundle(static), tier=None)


@pytest.fixture(scope="module")
def look(avatar) -> StillLook:
    return read_look(avatar)


def check(avatar, look, folder, files) -> list[dict]:
    """Every file that stands as its OFFSETs draw it gives the player's joints, every other is refused."""
    got = read_by_the_page(folder, look, files)
    for path, ours in zip(files, got, strict=True):
        source = motion_source(path)
        try:
            theirs, _ = avatar.fit(source.load())
        except UserError:
            assert path.name in ours["error"]
            continue
        if not source.facts["rest pose"].startswith("offsets"):
            assert "draw nobody who stands" in ours["error"], path
            assert COMMAND.format(path.name) in ours["error"]
            continue
        assert "error" not in ours, (path, ours)
        assert ours["fps"] == pytest.approx(theirs.fps)
        joints = [
            joint_transforms(np.asarray(m["poses"], float), look.rest, look.parents)[..., :3, 3] + m["trans"][:, None]
            for m in (ours, {"poses": theirs.poses, "trans": theirs.trans})
        ]
        assert np.abs(joints[0] - joints[1]).max() < CLOSE, path
        # orientations too, which the last joints of a limb would not show
        turned = [joint_transforms(np.asarray(p, float), look.rest, look.parents)[..., :3, :3] for p in
                  (ours["poses"], theirs.poses)]  # fmt: skip
        assert np.abs(turned[0] - turned[1]).max() < CLOSE, path
    return got


def test_rigs_of_many_programs(avatar, look, tmp_path):
    files = []
    for k, rig in enumerate(RIGS.values()):
        files.append(tmp_path / f"rig{k}.bvh")
        write_bvh(files[-1], random_angles(12), ROOT, **rig)
    write_bvh(tmp_path / "plain.bvh", random_angles(12, 1), ROOT)
    for k, exporter in enumerate(EXPORTERS.values()):
        files.append(tmp_path / f"exporter{k}.bvh")
        write_parsed(
            files[-1], renamed(exporter.change(read_bvh(tmp_path / "plain.bvh")), exporter.table, exporter.prefix)
        )
    got = check(avatar, look, tmp_path, files)
    assert sum("error" not in one for one in got) >= 8


@pytest.mark.shared
def test_clips_and_cases(avatar, look, tmp_path):
    files = sorted([*(places.SHARED / "motions").glob("*.bvh"), *(places.SHARED / "cases").glob("*.bvh")])
    if not files:
        pytest.skip(f"{places.SHARED} is absent: the files are not part of the package")
    got = dict(zip([path.name for path in files], check(avatar, look, tmp_path, files), strict=True))
    assert {name for name, one in got.items() if "error" in one} == {"bones_along_x.bvh", "frame_time_zero.bvh"}
    assert COMMAND.format("frame_time_zero.bvh") + " --set fps=30" in got["frame_time_zero.bvh"]["error"]


def changed(path, name, change) -> object:
    out = path.with_name(name)
    out.write_bytes(change(path.read_text()).encode("utf-8"))
    return out


def test_files_as_people_have_them(avatar, look, tmp_path):
    """Comments, commas, channels for every joint, a root that moves nothing, angles that look like radians."""
    plain = tmp_path / "plain.bvh"
    write_bvh(plain, random_angles(12), ROOT)
    files = [
        changed(plain, "comments.bvh", lambda t: t.replace("MOTION", "# a comment\nMOTION // another")),
        changed(
            plain, "commas.bvh", lambda t: t.split("MOTION")[0] + "MOTION" + t.split("MOTION")[1].replace(".", ",")
        ),
        changed(
            plain, "lower.bvh", lambda t: t.replace("ROOT", "root").replace("JOINT", "Joint").replace("\n", "\r\n")
        ),
        changed(plain, "more.bvh", lambda t: t + t.rstrip().rsplit("\n", 1)[1] + "\n"),
    ]
    one_frame = tmp_path / "one.bvh"
    write_bvh(one_frame, random_angles(1), ROOT[:1])
    bvh = read_bvh(plain)
    bvh.moves = {j: np.tile(bvh.offsets[j], (12, 1)) for j in range(1, len(bvh.names))}
    bvh.moves[4] = bvh.moves[4] + np.linspace(0, 1, 12)[:, None]
    write_parsed(tmp_path / "moves.bvh", bvh)
    small = tmp_path / "small.bvh"
    write_bvh(small, random_angles(12) / 60, ROOT)
    got = check(avatar, look, tmp_path, [*files, one_frame, tmp_path / "moves.bvh", small])
    assert "1 frames more" in got[3]["notes"][0]
    assert "if these are radians" in got[6]["notes"][0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: "", "does not begin with HIERARCHY"), (lambda t: t[:200], "line"),
        (lambda t: t.replace("Frames: 12", "Frames: 1.5"), "whole number"),
        (lambda t: t.replace("Frames: 12", "Frames: x"), "'x' is not a number"),
        (lambda t: t.replace("Frames: 12", "Frames: 13"), "cut short"),
        (lambda t: t.replace("OFFSET", "OFFSETS", 1), "'OFFSETS' is not a word"),
        (lambda t: t.replace("Zrotation", "Wrotation", 1), "CHANNELS needs"),
        (lambda t: t.rsplit("\n", 2)[0] + "\n" + "nan " * 200, "no number to play"),
        (lambda t: t.replace("Leg", "Bone"), "no joint of the rig is known as left_hip"),
        (lambda t: t.replace("Frame Time: ", "Frame Time: 9"), "no recording has"),
    ],
)  # fmt: skip
def test_damage_is_one_sentence(look, tmp_path, change, said):
    write_bvh(tmp_path / "plain.bvh", random_angles(12), ROOT)
    bad = changed(tmp_path / "plain.bvh", "bad.bvh", change)
    (got,) = read_by_the_page(tmp_path, look, [bad])
    assert said in got["error"]
    assert "bad.bvh" in got["error"]
    with pytest.raises(UserError):
        motion_source(bad).load()


def test_names_of_joints_are_understood_alike(tmp_path):
    plain = [name for name, _, _ in MIXAMO]
    parents = [next((j for j, (n, _, _) in enumerate(MIXAMO) if n == p), -1) for _, p, _ in MIXAMO]
    ways = (
        "{}",
        "Robot_{}",
        "my.rig.{}",
        "ns1|ns2|{}",
        "{}_jnt",
        "Robot_{}_JNT",
        "x-{}",
        "01_{}",
        "mixamorig:{}",
        "{}_12",
    )
    rigs = [[way.format(name) for name in plain] for way in ways]
    rigs += [[exporter.table.get(name, name) for name in plain] for exporter in EXPORTERS.values()]
    rigs += [
        [f"bone{j}" for j in range(len(plain))],
        [n.lower() for n in plain],
        [f"{n}_{j:03d}" for j, n in enumerate(plain)],
    ]
    names = sorted(
        {name for rig in rigs for name in rig} | {"", "L", "___", "lung", "ribs", "upper_arm.L.001", "LUArm", "Head_M"}
    )
    got = run(
        tmp_path,
        "return [given.rigs.map((names) => [...matchRig(names, given.parents)]), given.names.map(splitName)];",
        rigs=rigs, parents=parents, names=names,
    )  # fmt: skip
    assert [dict(pairs) for pairs in got[0]] == [match_rig(rig, parents) for rig in rigs]
    assert [tuple(pair) for pair in got[1]] == [split_name(name) for name in names]
