"""Captures in other people's layouts, read in place: where the body falls in the images, masks, training."""

from __future__ import annotations

import dataclasses

import foreign_captures as write
import numpy as np
import pytest
from tiny_capture import SMALL, demo

from gavatar.capture.capture import read_capture
from gavatar.capture.check import check_capture
from gavatar.capture.opening import open_capture
from gavatar.cli.prepare import main as prepare
from gavatar.registry import CAPTURES, load_plugins

load_plugins()

LAYOUTS = {
    "instantavatar": ("instantavatar", write.instantavatar),
    "instantavatar, NeuMan": ("instantavatar", lambda f: write.instantavatar(f, npy=False, thetas=False)),
    "upstream": ("upstream", write.upstream),
    "upstream, moving camera": ("upstream", lambda f: write.upstream(f, moving=True)),
    "upstream, SMPL-X": ("upstream", lambda f: write.upstream(f, joints=55)),
    "zju": ("zju", write.zju),
    "zju, params": ("zju", lambda f: write.zju(f, params="params")),
    "neuman": ("neuman", write.neuman),
}


@pytest.fixture(params=LAYOUTS)
def layout(request, tmp_path):
    folder = tmp_path / "person"
    folder.mkdir()
    name, writer = LAYOUTS[request.param]
    return name, folder, writer(folder)


def test_the_body_falls_where_the_data_sets_own_reader_puts_it(layout):
    name, folder, expected = layout
    before = sorted(p for p in folder.rglob("*"))
    capture = open_capture(folder).placed(expected["body"])
    capture.check()
    seen = {view for views in capture.splits.values() for view in views}
    assert {(v.camera, v.frame) for v in seen} == set(expected["pixels"])
    motion = capture.motion
    for view in seen:
        posed, _ = expected["body"].posed(
            motion.poses[view.frame].astype(float), motion.betas, motion.trans[view.frame]
        )
        pixels = capture.camera(view).project(posed)[:, :2]
        # 2e-3 pixels: poses of a float32 motion, radians near pi, over a metre at a focal length of 60
        np.testing.assert_allclose(pixels, expected["pixels"][view.camera, view.frame], atol=2e-3, err_msg=str(view))
    assert sorted(p for p in folder.rglob("*")) == before  # nothing is written or copied
    assert CAPTURES[name].factory.recognises(folder)


def test_the_person_stands_upright_in_the_world(layout):
    _, folder, expected = layout
    capture = open_capture(folder).placed(expected["body"])
    from gavatar_runtime.geometry.rotations import matrix_from_axis_angle

    up = matrix_from_axis_angle(capture.motion.poses[:, 0].astype(float))[:, 1, 1]
    assert up.mean() > 0.9


def test_masks_are_the_person_and_nothing_else(layout):
    _, folder, expected = layout
    capture = open_capture(folder)
    color, alpha = capture.load(capture.views("train")[0])
    np.testing.assert_array_equal(alpha > 0.5, expected["person"])
    assert set(np.unique(alpha)) == {0.0, 1.0}
    assert color[~expected["person"]].max() == 0


def test_a_sound_capture_passes_the_check_and_each_layout_is_recognised_alone(layout, capsys):
    name, folder, _ = layout
    found = check_capture(folder)
    assert (found.format, found.faults) == (name, [])
    recognising = [c.name for c in CAPTURES if c.factory.recognises(folder)]
    assert recognising == [name]
    with pytest.raises(SystemExit) as done:
        prepare(["--check", str(folder)])
    assert done.value.code == 0
    assert "nothing is wrong" in capsys.readouterr().out


def test_on_a_body_of_another_family_the_pelvis_stays_and_the_shape_is_left_out(tmp_path):
    from make_bundle import free_body

    expected = write.instantavatar(tmp_path)
    own, free = open_capture(tmp_path).placed(expected["body"]), open_capture(tmp_path).placed(free_body())
    assert free.motion.betas is None
    assert own.motion.betas.shape == (10,)
    mean = np.array([0, -0.23, 0.03])  # of SMPL, where the capture's own body has another random one
    rest = free_body().shaped(None)[1][0]
    turn = np.diag([1, -1, -1])
    transl = np.load(tmp_path / "poses.npz")["transl"]
    np.testing.assert_allclose(free.motion.trans + rest, (transl + mean) @ turn, atol=1e-5)
    np.testing.assert_array_equal(free.motion.poses, own.motion.poses)
    smplx = dataclasses.replace(expected["body"], name="smplx")
    assert open_capture(tmp_path).placed(smplx).motion.betas is None  # SMPL's shapes are not SMPL-X's


def test_gavatars_own_capture_is_not_moved_by_a_body():
    from make_bundle import free_body

    capture = read_capture(demo())
    assert capture.placed(free_body()) is capture


def test_training_takes_a_foreign_capture_with_a_moving_camera(tmp_path):
    from gavatar.config import compose_config
    from gavatar.training.run import open_run, train

    folder = tmp_path / "person"
    folder.mkdir()
    write.upstream(folder, moving=True)
    small = [setting for setting in SMALL if not setting.startswith("encoder")]
    config = compose_config([f"capture={folder}", "encoder=none", *small])
    train(config, tmp_path / "run")
    run = open_run(tmp_path / "run")
    assert run.capture.body_model == "smpl"
    assert len(run.motion) == 6
