"""What the viewer draws from: wishes within bounds, motions that are sent, tiers and levels of detail."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest

from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.motions import built_in_motions
from gavatar_runtime.view.server import _hello
from gavatar_runtime.view.viewed_avatar import KEPT, MOST, ViewedAvatar, Wish

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from tiered_members import write_tiered

CAMERA = {"view": [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 3], "fx": 80, "fy": 80, "cx": 16, "cy": 16}
WISH = {"motion": "turn", "time": 0, "camera": CAMERA, "background": [1, 1, 1], "width": 32, "height": 32,
        "tier": "full", "gaussians": None}  # fmt: skip


@pytest.fixture
def scene(static) -> ViewedAvatar:
    return ViewedAvatar(read_bundle(static))


def npz(**arrays) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


AMASS = npz(poses=np.zeros((5, 156), np.float32), trans=np.zeros((5, 3), np.float32), mocap_framerate=30.0)


def test_a_wish_is_what_the_page_says():
    wish = Wish.of({**WISH, "background": [-1, 0.5, 9], "gaussians": 100})
    assert wish.background == (0, 0.5, 1)
    assert wish.gaussians == 100
    assert (wish.camera.width, wish.camera.fx) == (32, 80)
    assert wish.camera.T_camera_world.shape == (4, 4)


@pytest.mark.parametrize("side", [1, MOST])
def test_the_bounds_of_a_picture_are_in(side):
    assert Wish.of({**WISH, "width": side}).camera.width == side


@pytest.mark.parametrize(
    ("name", "value"),
    [("width", 0), ("width", MOST + 1), ("height", -5), ("height", math.inf), ("height", None), ("time", math.nan),
     ("time", True), ("time", "1"), ("gaussians", 0), ("gaussians", 2**40), ("background", [1, 1]),
     ("background", "red"), ("tier", 3), ("motion", None), ("motion", "x" * 501), ("camera", None), ("camera", []),
     ("camera", {**CAMERA, "fx": 0}), ("camera", {**CAMERA, "fy": -1}), ("camera", {**CAMERA, "view": [0.0] * 12}),
     ("camera", {**CAMERA, "view": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0]}),
     ("camera", {**CAMERA, "view": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 3]}),
     ("view", {**CAMERA, "view": [1] * 11}), ("cx", {**CAMERA, "cx": math.nan})],
)  # fmt: skip
def test_what_cannot_be_is_refused(name, value):
    with pytest.raises(WrongValue, match=name):
        Wish.of({**WISH, "camera" if isinstance(value, dict) else name: value})


def test_its_motions_are_those_given_and_the_built_in_ones(static):
    names = ViewedAvatar(read_bundle(static)).motion_names
    assert names[0] == "idle"
    assert sorted(names) == sorted(built_in_motions())
    scene = ViewedAvatar(read_bundle(static), ["wave"])
    assert scene.motion_names[0] == "wave"
    assert set(scene.motion_names) == set(built_in_motions())
    for name in scene.motion_names:  # each can be played
        said = scene.described(name)
        assert said["count"] == len(scene.motion(name))
        assert np.isfinite(said["extent"]["points"]).all()


def test_a_file_that_is_sent_plays_by_its_name(scene):
    name, _ = scene.add_file("walk.npz", AMASS)
    assert name == "walk"
    assert "walk" in scene.motion_names
    assert len(scene.motion("walk")) == 5
    image, stages, count = scene.draw(Wish.of({**WISH, "motion": "walk", "time": 0.05}))
    assert image.shape == (32, 32, 3)
    assert stages["all"] > 0
    assert count == 300


@pytest.mark.parametrize(
    "name", ["", ".", "..", "/", "../..", ".npz", "C:\\", "x" * 201 + ".npz", "walk", "walk.", "walk.n/pz", "a.\x00"]
)
def test_names_that_are_none_of_a_file_are_refused(scene, name):
    with pytest.raises(WrongValue, match="no name"):
        scene.add_file(name, AMASS)


@pytest.mark.parametrize("name", ["../../etc/walk.npz", "..\\..\\walk.npz", "/root/walk.npz", "C:\\x\\walk.npz"])
def test_of_a_path_only_the_last_name_is_taken(scene, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert scene.add_file(name, AMASS)[0] == "walk"
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["walk.npz", "walk.bvh", "walk.pkl", "walk.json", "walk.npy", "walk.mp4", "walk.zzz"])
def test_a_file_that_cannot_be_read_is_told_by_its_own_name(scene, name):
    before = scene.motion_names
    with pytest.raises(UserError) as error:
        scene.add_file(name, b"nothing of the kind")
    assert "walk" in str(error.value)
    assert "gavatar-view-" not in str(error.value)
    assert scene.motion_names == before


def test_a_level_of_detail_draws_fewer(tiered_bundle):
    scene = ViewedAvatar(tiered_bundle)
    _, _, every = scene.draw(Wish.of({**WISH, "tier": scene.tier}))
    assert every == tiered_bundle.manifest.gaussians
    _, _, few = scene.draw(Wish.of({**WISH, "tier": scene.tier, "gaussians": 1}))
    assert 0 < few <= every


def test_only_a_few_avatars_stay_open(tmp_path):
    scene = ViewedAvatar(read_bundle(write_tiered(tmp_path / "t.gavatar")))
    assert len(scene.tiers) > KEPT
    for tier in (*scene.tiers, scene.tiers[0]):
        scene.draw(Wish.of({**WISH, "tier": tier}))
    assert len(scene._open) == KEPT


def test_the_tier_to_begin_with(tmp_path):
    bundle = read_bundle(write_tiered(tmp_path / "t.gavatar"))
    assert ViewedAvatar(bundle, tier="blendshape").tier == "blendshape"
    with pytest.raises(WrongValue, match="`tier=gold`"):
        ViewedAvatar(bundle, tier="gold")


def test_a_page_begins_with_as_many_gaussians_as_were_asked_for(static, monkeypatch):
    bundle = read_bundle(static)
    every = bundle.manifest.gaussians
    assert [_hello(ViewedAvatar(bundle, gaussians=g))["first"] for g in (None, 5, every, 10 * every)] == [
        every, 5, every, every
    ]  # fmt: skip
    monkeypatch.setitem(bundle.manifest.training, "pixel_m", 0.2)  # of a person of ten pixels, who is worth few
    assert _hello(ViewedAvatar(bundle, gaussians="auto"))["first"] == min(1000, every)


@pytest.mark.parametrize("wrong", [0, -3, "some"])
def test_no_other_number_of_gaussians_is_taken(static, wrong):
    with pytest.raises(WrongValue, match=f"`gaussians={wrong}`: give a whole number from 1 up, or auto"):
        ViewedAvatar(read_bundle(static), gaussians=wrong)
