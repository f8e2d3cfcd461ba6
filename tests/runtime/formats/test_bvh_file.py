"""The syntax of BVH, as exporters write it and as it gets damaged."""

from __future__ import annotations

import numpy as np
import pytest
from bvh_rigs import MIXAMO, write_bvh

from gavatar_runtime.errors import UserError
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
