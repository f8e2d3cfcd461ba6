"""tools/fuzz.py: damaged files leave nothing but results and sentences, and what is neither is told."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from random import Random

import numpy as np
import pytest
from places import ROOT

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from motion_files import amass
from tiered_members import write_tiered

from gavatar_runtime.errors import UserError

CASES = 100


@pytest.fixture(scope="module")
def fuzz():
    """The module tools/fuzz.py."""
    sys.path.insert(0, str(ROOT / "tools"))
    spec = importlib.util.spec_from_file_location("fuzz", ROOT / "tools" / "fuzz.py")
    module = sys.modules["fuzz"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path.remove(str(ROOT / "tools"))
    del sys.modules["fuzz"]


@pytest.fixture(scope="module")
def material(fuzz, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    bundle = write_tiered(folder / "a.gavatar")
    motions = folder / "motions"
    motions.mkdir()
    amass(motions / "a.npz")
    return {
        "bundle": fuzz.Material(bundle),
        "zip": fuzz.Material(bundle),
        "motion": fuzz.Material(motions, bundle),
    }


def fuzzed(*arguments: object) -> str:
    """What a process of its own prints: to fork a worker of pytest, which has threads, would hang now and then."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=ROOT / "tools").stdout


@pytest.mark.parametrize("target", ["bundle", "zip", "motion"])
def test_damage_leaves_results_and_sentences(material, target):
    path, avatar = material[target].path, material["bundle"].path
    report = fuzzed("fuzz.py", target, path, "--avatar", avatar, "--cases", CASES)
    found = re.match(r"(\d+) fine, (\d+) refused, 0 bad, 0 late, 0 crash, 0 slow", report)
    assert found, report
    assert int(found[1]) > 0 < int(found[2])
    assert int(found[1]) + int(found[2]) == CASES


SPOILT = """
import sys
from pathlib import Path
from random import Random
import fuzz

def case(material, r, folder):
    if r.random() == Random(7).random():
        exec(sys.argv[2], vars(fuzz))
    return ""

fuzz.TARGETS["bundle"] = case
outcomes = fuzz.fuzz("bundle", fuzz.Material(Path(sys.argv[1])), range(5, 10))
print(*(o.kind for o in outcomes))
print(fuzz.report(outcomes))
"""


@pytest.mark.parametrize(
    ("does", "kind"),
    [
        ("pass", "fine"),
        ("raise UserError('no')", "refused"),
        ("raise UserError('no\\nno')", "bad"),
        ("raise KeyError('a')", "bad"),
        ("os.write(2, b'E: onnxruntime')", "bad"),
        ("print('E')", "bad"),
        ("raise Late('x')", "late"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "crash"),
    ],
)
def test_what_comes_of_a_case_is_told_apart(fuzz, material, does, kind):
    kinds, report = fuzzed("-c", SPOILT, material["bundle"].path, does).split("\n", 1)
    assert kinds.split() == ["fine", "fine", kind, "fine", "fine"]
    assert (f"seed 7: {kind}" in report) == (kind in fuzz.UNWANTED)


def test_the_same_seed_does_the_same_damage(fuzz):
    array = np.arange(12.0).reshape(3, 4)
    from fuzz_damage import damaged_array

    for seed in range(30):
        one, two = (damaged_array(Random(seed), array) for _ in range(2))
        assert one.dtype == two.dtype
        np.testing.assert_array_equal(one, two)


def test_a_frame_that_is_not_finite_is_no_result(fuzz, material, monkeypatch):
    avatar = fuzz._avatar(material["bundle"].path)
    motion = fuzz.read_motion("wave")
    fuzz.play_one_frame(avatar, motion, Random(0))
    whole = avatar.gaussians

    def spoilt(*arguments):
        found = whole(*arguments)
        found.means[0] = np.nan
        return found

    monkeypatch.setattr(avatar, "gaussians", spoilt)
    with pytest.raises((AssertionError, UserError)):
        fuzz.play_one_frame(avatar, motion, Random(0))
