"""Several avatars in one picture: who hides whom, who stands where, and one alone as before."""

from __future__ import annotations

import argparse
import dataclasses
import json

import cv2
import numpy as np
import pytest
from commands import run_play
from scipy.spatial.transform import Rotation

import gavatar_runtime as gr
from gavatar_runtime import Companion, Place
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.cli.play_arguments import placed_avatar
from gavatar_runtime.errors import WrongValue
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.performance import perform
from gavatar_runtime.values.gaussians import Gaussians, together

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import make_bundle, still

NUMPY = {"size": 48, "rasterizer": "numpy"}  # the plain reference


@pytest.fixture(scope="module")
def dense(tmp_path_factory):
    """A bundle whose Gaussians leave no gaps."""
    return make_bundle(tmp_path_factory.mktemp("dense") / "dense.gavatar", 3000, scale=0.03)


def drawn(bundle, out, **how):
    """(H, W, 3) uint8, the one frame."""
    perform(bundle, still(), out, **{**NUMPY, **how})
    return cv2.imread(str(out))


def test_a_person_behind_another_is_hidden_and_one_in_front_hides(dense, tmp_path):
    camera = gr.Camera(48, 48, 60, 60, 24, 24, gr.look_at(np.array([0, -0.2, 4.0]), np.array([0, -0.2, 0.0])))
    alone = drawn(dense, tmp_path / "a.png", camera=camera)
    # a quarter behind: smaller on the picture, and inside the outline of who stands before
    behind = drawn(
        dense, tmp_path / "b.png", camera=camera, beside=[Companion(dense, still(), Place(z=-0.25, heading=180))]
    )
    ahead = drawn(
        dense, tmp_path / "c.png", camera=camera, beside=[Companion(dense, still(), Place(z=0.25, heading=180))]
    )
    back = drawn(dense, tmp_path / "d.png", camera=camera, place=Place(z=0.25, heading=180))
    chest = np.s_[16:26, 21:27]
    # the cover is not quite opaque: a colour shows through by less than a few of 255
    assert np.abs(alone[chest].astype(int) - behind[chest]).max() <= 3
    assert np.abs(back[chest].astype(int) - ahead[chest]).max() <= 3
    assert np.abs(alone[chest].astype(int) - back[chest]).max() > 50  # front and back are of different colours


def test_the_order_in_which_they_are_named_changes_nothing(dense, tmp_path):
    camera = gr.Camera(48, 48, 60, 60, 24, 24, gr.look_at(np.array([1.0, 0, 4.0]), np.array([0, -0.2, 0.0])))
    left, right = Place(0.3, -0.1, 20), Place(-0.3, 0.4, -50)
    one = drawn(dense, tmp_path / "a.png", camera=camera, place=left, beside=[Companion(dense, still(), right)])
    other = drawn(dense, tmp_path / "b.png", camera=camera, place=right, beside=[Companion(dense, still(), left)])
    assert np.abs(one.astype(int) - other).max() <= 1  # ties of depth and sums in another order


@pytest.mark.parametrize("bundle", ["static", "dynamic"])
def test_one_alone_is_as_it_was_bit_for_bit(bundle, request, tmp_path):
    bundle = request.getfixturevalue(bundle)
    avatar = Avatar(bundle)
    motion = avatar.fit(read_motion("wave", fps=4))[0]
    perform(bundle, motion, tmp_path / "f" / "%d.ply", beside=(), place=Place())
    report = perform(bundle, motion, tmp_path / "g" / "%d.ply")
    assert report.frames == len(motion)
    for i in range(len(motion)):
        assert (tmp_path / "f" / f"{i}.ply").read_bytes() == (tmp_path / "g" / f"{i}.ply").read_bytes()
    only = avatar.gaussians(*motion.at(0))
    assert together([only]) is only


def test_all_are_in_the_picture_and_shorter_motions_repeat(dense, tmp_path):
    beside = [Companion(dense, still(3, fps=10), Place(1.5, 0, 90)), Companion(dense, still(1), Place(-1.5))]
    report = perform(dense, still(5, fps=10), tmp_path / "f/", beside=beside, **NUMPY)
    assert (report.frames, report.fps) == (13, 30)  # 0.4 s at the highest rate of the three
    assert report.gaussians == 9000
    assert report.avatar == "tester, tester, tester"
    image = cv2.imread(str(sorted((tmp_path / "f").iterdir())[0]))
    white = (image == 255).all(-1)
    assert np.concatenate([white[0], white[-1], white[:, 0], white[:, -1]]).all()
    seen = np.flatnonzero(~white.all(0))
    assert np.ptp(seen) > 30  # all over the width


def test_a_place_turns_about_the_origin_and_moves():
    pelvis = np.array([0.0, -0.2, 0.1])
    motion = still(2)
    motion.trans[1] = (0, 0, 1)
    moved = Place(2, 3, 90).of(motion, pelvis)
    # the pelvis: from 0.1 and 1.1 ahead to as much to the left, then 2 to the left and 3 ahead
    np.testing.assert_allclose(moved.trans + pelvis, [(2.1, -0.2, 3), (3.1, -0.2, 3)], atol=1e-6)
    np.testing.assert_allclose(Rotation.from_rotvec(moved.poses[0, 0]).apply((0, 0, 1)), (1, 0, 0), atol=1e-6)
    assert Place().of(motion, pelvis) is motion
    back = Place(heading=360).of(motion, pelvis)
    np.testing.assert_allclose(back.trans, motion.trans, atol=1e-6)


def test_what_one_has_and_another_lacks_is_filled_in_as_it_is_meant():
    rng = np.random.default_rng(0)
    f = lambda *shape: rng.random(shape, np.float32)  # noqa: E731
    one = Gaussians(f(2, 3), f(2), f(2, 3), normals=f(2, 3))
    other = Gaussians(f(3, 3), f(3, 3), f(3, 3), opacities=f(3), quaternions=f(3, 4))
    both = together([one, other])
    assert len(both) == 5
    np.testing.assert_array_equal(both.scales[:2], np.repeat(one.scales[:, None], 3, 1))
    np.testing.assert_array_equal(both.opacities, [1, 1, *other.opacities])
    np.testing.assert_array_equal(both.quaternions[:2], [(1, 0, 0, 0)] * 2)
    assert both.normals is None
    assert both.means.dtype == both.opacities.dtype == both.scales.dtype == np.float32
    twice = together([one, one])
    np.testing.assert_array_equal(twice.normals, np.concatenate([one.normals] * 2))
    assert twice.opacities is twice.quaternions is None
    nobody = {name: getattr(one, name)[:0] for name in ("means", "scales", "colors", "normals")}
    assert len(together([one, dataclasses.replace(one, **nobody)])) == 2


@pytest.mark.usefixtures("dots")
def test_the_command_places_them(static, dynamic, tmp_path, capsys):
    options = [
        "--motion", "wave", "--with", f"{dynamic}@1,-0.5:30", "--with", static, "--with-motion", "turn",
        "--set", "motion.fps=2", "--json", tmp_path / "t.json", "--at=-1,0",
    ]  # fmt: skip
    assert run_play(static, "--rasterizer", "dots", "--size", 16, "--out", tmp_path / "a.png", *options) == 0
    report = json.loads((tmp_path / "t.json").read_text())
    assert report["motion"] == "wave, turn, turn"
    assert report["gaussians"] == 900
    for more, message in (
        (["--with-tier", "full"] * 3, "--with-tier is given 3"),
        (["--budget-ms", "5"], "--budget-ms"),
    ):
        assert run_play(static, "--rasterizer", "dots", "--out", tmp_path / "b.png", *options, *more) == 2
        assert message in capsys.readouterr().err
    assert run_play(static, "--with-motion", "turn", "--out", tmp_path / "b.png") == 2


def test_a_place_is_read_from_behind_the_name():
    assert placed_avatar("a.gavatar") == ("a.gavatar", None)
    assert placed_avatar("me@home/a.gavatar") == ("me@home/a.gavatar", None)
    assert placed_avatar("me@home/a.gavatar@-1,.5:-90") == ("me@home/a.gavatar", (-1, 0.5, -90))
    for wrong in ("a.gavatar@1", "a.gavatar@1,2,3", "a.gavatar@1,2:x"):
        with pytest.raises(argparse.ArgumentTypeError, match="X,Z"):
            placed_avatar(wrong)


@pytest.mark.parametrize("wrong", [{"x": float("nan")}, {"z": 1e9}, {"heading": "left"}, {"x": True}])
def test_a_place_that_is_none_is_refused(wrong):
    with pytest.raises(WrongValue, match=f"`{next(iter(wrong))}="):
        Place(**wrong)
