"""The syntax of BVH, as exporters write it and as it gets damaged."""

from __future__ import annotations

import re

import numpy as np
import pytest
from bvh_rigs import MIXAMO, random_angles, write_bvh

from gavatar_runtime.errors import UserError
from gavatar_runtime.formats.bvh_file import read_bvh
from gavatar_runtime.motions import read_motion

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


ANGLES = random_angles(3)
ROOT = np.array([[0.0, 95, 0], [4, 94, 1], [9, 95, 3]])
WAYS = {
    "no blank after the colons": lambda t: t.replace("Frames: ", "Frames:").replace("Frame Time: ", "Frame Time:"),
    "a blank before the colons": lambda t: t.replace("Frames: ", "Frames : ").replace("Time: ", "Time : "),
    "no colons": lambda t: t.replace("Frames: ", "Frames\t").replace("Frame Time: ", "FrameTime "),
    "braces on the line of the joint": lambda t: re.sub(r"\n\s*\{", " {", t),
    "closing braces on one line": lambda t: re.sub(r"\}\s*\n\s*\}", "} }", t),
    "all on few lines": lambda t: re.sub(r"\n\s*\{\s*\n\s*", "{", t),
    "tabs": lambda t: t.replace(" ", "\t"),
    "lines of Windows": lambda t: t.replace("\n", "\r\n"),
    "lines of old Macs": lambda t: t.replace("\n", "\r"),
    "blank lines": lambda t: t.replace("\n", "\n\n"),
    "comments": lambda t: "# made by hand\n" + t.replace("MOTION", "// the motion\nMOTION ; from here on"),
    "capitals": lambda t: t.replace("OFFSET", "Offset").replace("CHANNELS", "channels").replace("Frames", "FRAMES"),
    "channels in capitals": lambda t: t.replace("rotation", "ROTATION"),
    "End Site in one word": lambda t: t.replace("End Site", "EndSite"),
    "End Site with a name": lambda t: t.replace("End Site", "End Site_tip"),
    "End Site in small letters": lambda t: t.replace("End Site", "end  site"),
    "End Site without braces": lambda t: re.sub(r"End Site\s*\{\s*(OFFSET[^\n]*)\n\s*\}", r"End Site\n\1", t),
    "the frame time first": lambda t: re.sub(r"(Frames: \d+)\n(Frame Time: \S+)", r"\2\n\1", t),
    "scientific numbers": lambda t: t.replace("95.000000", "9.5e+01").replace("0.03333333", "3.333333E-2"),
    "commas for points": lambda t: re.sub(r"(\d)\.(\d)", r"\1,\2", t),
    "no line end at the end": lambda t: t.rstrip("\n"),
}  # fmt: skip


@pytest.fixture
def plain(tmp_path):
    write_bvh(tmp_path / "plain.bvh", ANGLES, ROOT)
    return tmp_path / "plain.bvh"


def assert_same(mine, theirs):
    assert mine.names == theirs.names
    # 1e-12: the same digits, in another notation
    for field in ("parents", "offsets", "tips", "rotations", "root"):
        np.testing.assert_allclose(getattr(mine, field), getattr(theirs, field), atol=1e-12, err_msg=field)
    assert mine.fps == pytest.approx(theirs.fps, rel=1e-6)


@pytest.mark.parametrize("way", WAYS)
def test_the_ways_of_exporters_read_as_the_plain_one(plain, tmp_path, way):
    text = WAYS[way](plain.read_text())
    (tmp_path / "other.bvh").write_bytes(text.encode())
    assert_same(read_bvh(tmp_path / "other.bvh"), read_bvh(plain))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin1", "shift-jis"])
def test_text_of_any_encoding_is_read(plain, tmp_path, encoding):
    name = {"latin1": "Hüfte", "shift-jis": "腰"}.get(encoding, "Hips")
    text = plain.read_text().replace("ROOT Hips", f"ROOT {name}")
    (tmp_path / "other.bvh").write_bytes(text.encode(encoding))
    other = read_bvh(tmp_path / "other.bvh")
    assert encoding == "shift-jis" or other.names[0] == name
    other.names[0] = "Hips"
    assert_same(other, read_bvh(plain))


def test_more_frames_than_it_says_are_left_out_with_a_note(plain, tmp_path):
    (tmp_path / "long.bvh").write_text(plain.read_text().replace("Frames: 3", "Frames: 2"))
    motion = read_motion(tmp_path / "long.bvh")
    assert len(motion) == 2
    assert any("holds 1 frames more than 'Frames: 2' says" in note for note in motion.notes)


def test_a_frame_time_of_zero_needs_the_rate(plain, tmp_path):
    (tmp_path / "zero.bvh").write_text(re.sub(r"Frame Time: \S+", "Frame Time: 0", plain.read_text()))
    with pytest.raises(UserError, match=r"zero\.bvh: Frame Time .*`fps=30`"):
        read_motion(tmp_path / "zero.bvh")
    assert read_motion(tmp_path / "zero.bvh", fps=24).fps == 24


def with_positions(text: str, places) -> str:
    """Every joint but the root with position channels before its rotations; places(j) are its three numbers."""
    head, tail = text.split("MOTION\n")
    head = head.replace("CHANNELS 3 ", "CHANNELS 6 Xposition Yposition Zposition ")
    lines = tail.splitlines()
    rows = []
    for row in lines[2:]:
        numbers = row.split()
        out = numbers[:6]
        for j in range(1, (len(numbers) - 3) // 3):
            out += [f"{v:.6f}" for v in places(j)] + numbers[3 + 3 * j : 6 + 3 * j]
        rows.append(" ".join(out))
    return head + "MOTION\n" + "\n".join([*lines[:2], *rows]) + "\n"


@pytest.mark.parametrize("way", ["the place", "added to the OFFSET", "the place, OFFSETs zero"])
def test_positions_on_all_joints_are_where_they_are(plain, tmp_path, way):
    expected = read_bvh(plain)
    text = with_positions(
        plain.read_text(), lambda j: 0 * expected.offsets[j] if "added" in way else expected.offsets[j]
    )
    if "zero" in way:
        root, rest = text.split("JOINT", 1)
        text = root + "JOINT" + re.sub(r"(?<!End Site\n)OFFSET [-\d. ]+(?=\n\s*CHANNELS)", "OFFSET 0 0 0", rest)
    (tmp_path / "other.bvh").write_text(text)
    other = read_bvh(tmp_path / "other.bvh")
    assert len(other.moves) == len(other.names) - 1
    np.testing.assert_allclose(other.offsets[1:], expected.offsets[1:], atol=1e-6)  # six digits
    mine, theirs = read_motion(tmp_path / "other.bvh"), read_motion(plain)
    np.testing.assert_allclose(mine.poses, theirs.poses, atol=1e-5)
    np.testing.assert_allclose(mine.trans, theirs.trans, atol=1e-6)


@pytest.mark.parametrize("walks_in", ["Reference", "Hips"])
@pytest.mark.parametrize("turns_in", ["Reference", "Hips"])
@pytest.mark.parametrize("adds", [False, True])
def test_walk_and_turn_may_stand_in_a_joint_above_the_hips(plain, tmp_path, walks_in, turns_in, adds):
    """With a name of nothing known; the OFFSET of the hips may be far from where they go."""
    head, tail = plain.read_text().split("MOTION\n")
    offset = "OFFSET 0.000000 95.000000 0.000000"
    assert offset in head
    hips = head.replace("HIERARCHY\nROOT Hips", "JOINT Hips")
    if not adds and walks_in == "Hips":
        hips = hips.replace(offset, "OFFSET 0.8 93.9 -452")  # Bandai-Namco's
    head = "HIERARCHY\nROOT Armature_7\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition " + (
        "Zrotation Xrotation Yrotation\n" + hips + "}\n"
    )
    rows, track = [], []
    turned = read_bvh(plain).rotations[:, 0] if turns_in == "Reference" else np.tile(np.eye(3), (3, 1, 1))
    for row, R in zip(tail.splitlines()[2:], turned, strict=True):
        numbers = np.array(row.split(), float)
        places = {"Reference": np.zeros(3), "Hips": np.array([0, 95.0, 0])}
        places[walks_in] = numbers[:3] - (np.array([0, 95, 0]) if walks_in == "Reference" else 0)
        track.append(places["Reference"] + R @ places["Hips"])
        written = [places["Reference"], places["Hips"] - (np.array([0, 95, 0]) if adds else 0)]
        turns = [numbers[3:6] if turns_in == name else np.zeros(3) for name in places]
        rows.append([*written[0], *turns[0], *written[1], *turns[1], *numbers[6:]])
    lines = tail.splitlines()[:2] + [" ".join(f"{v:.6f}" for v in row) for row in rows]
    (tmp_path / "other.bvh").write_text(head + "MOTION\n" + "\n".join(lines))
    mine, theirs = read_motion(tmp_path / "other.bvh"), read_motion(plain)
    np.testing.assert_allclose(mine.poses, theirs.poses, atol=1e-5)  # six digits of degrees
    np.testing.assert_allclose(mine.trans, np.array(track) * 0.8 / 83, atol=1e-5)  # the rig's leg is 83 long
