"""tools/fuzz.py: damaged files leave nothing but results and sentences, and what is neither is told."""

from __future__ import annotations

import importlib.util
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


@pytest.mark.parametrize("target", ["bundle", "zip", "motion"])
def test_damage_leaves_results_and_sentences(fuzz, material, target):
    outcomes = fuzz.fuzz(target, material[target], range(CASES))
    assert [o.seed for o in outcomes] == list(range(CASES))
    assert {"fine", "refused"} == {o.kind for o in outcomes}, fuzz.report(outcomes)


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
def test_what_comes_of_a_case_is_told_apart(fuzz, material, monkeypatch, does, kind):
    def case(material, r, folder):
        if r.random() == Random(7).random():
            exec(does, vars(fuzz))
        return ""

    monkeypatch.setitem(fuzz.TARGETS, "bundle", case)
    outcomes = fuzz.fuzz("bundle", material["bundle"], range(5, 10))
    assert [o.kind for o in outcomes] == ["fine", "fine", kind, "fine", "fine"]
    assert (f"seed 7: {kind}" in fuzz.report(outcomes)) == (kind in fuzz.UNWANTED)


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
