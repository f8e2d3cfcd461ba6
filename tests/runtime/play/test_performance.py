"""Playing from a program: what the command does, with typed values."""

from __future__ import annotations

import dataclasses
import inspect
import shutil

import cv2
import numpy as np
import pytest
from dots import Dots
from plyfile import PlyData
from video_frames import frames_of

from gavatar_runtime import native_library
from gavatar_runtime.avatar.adaptive import AdaptiveAvatar
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.cli.play import OURS
from gavatar_runtime.cli.play_arguments import parser
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.motions import MOTIONS
from gavatar_runtime.play.outputs import video_encoder
from gavatar_runtime.play.performance import perform
from gavatar_runtime.render.rasterizers import native

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import still

pytestmark = pytest.mark.usefixtures("dots")
SMALL = {"size": 16, "rasterizer": "dots"}


def test_a_path_a_bundle_and_an_avatar_play_the_same(static, tmp_path):
    sources = {"path": static, "text": str(static), "bundle": read_bundle(static), "avatar": Avatar(static)}
    for name, source in sources.items():
        report = perform(source, "wave", tmp_path / f"{name}.png", frames=slice(0, 30, 10), **SMALL)
        assert (report.frames, report.avatar, report.motion, report.tier) == (3, "tester", "wave", "full")
        assert report.output == str(tmp_path / f"{name}.png")
    images = [cv2.imread(str(tmp_path / f"{name}.png")) for name in sources]
    assert all((image == images[0]).all() for image in images)


def test_the_report_says_what_was_played(dynamic, tmp_path):
    report = perform(dynamic, still(4, fps=12), tmp_path / "a.mp4", width=20, height=30, threads=1, rasterizer="dots")
    assert len(frames_of(tmp_path / "a.mp4")) == report.frames == len(report.timings) == 4
    assert (report.width, report.height, report.fps, report.gaussians) == (20, 30, 12, 300)
    assert (report.rasterizer, report.threads, report.gaussians) == ("Dots", 1, len(Avatar(dynamic)))
    assert (report.budget_ms, report.levels, report.notes, report.ignored_joints) == (None, (), (), ())
    assert 0 < report.ready_seconds < np.inf


def test_a_motion_may_be_a_file_and_what_the_body_lacks_is_told_and_kept(static, tmp_path):
    np.savez(tmp_path / "m.npz", poses=np.full((1, 72), 0.1), mocap_framerate=30.0)
    told = []
    report = perform(static, tmp_path / "m.npz", tmp_path / "a.png", tell=told.append, **SMALL)
    assert report.ignored_joints == ("left_hand", "right_hand")
    assert report.notes == tuple(told) == ("the body has no left_hand, right_hand; the motion's are ignored",)


def test_the_default_motion_is_that_of_the_registry(static, tmp_path):
    assert perform(static, out=tmp_path / "a.png", frames=slice(1), **SMALL).motion == MOTIONS.default


def test_progress_is_called_after_each_frame(static, tmp_path):
    calls = []
    perform(static, still(3), tmp_path / "f/", progress=lambda *c: calls.append(c), **SMALL)
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_a_rasterizer_that_is_built_already_draws(static, tmp_path):
    dots = Dots()
    perform(static, still(3), tmp_path / "f/", size=8, rasterizer=dots, threads=1)
    assert len(dots.cameras) == 3
    with pytest.raises(ValueError, match="built already"):
        perform(static, still(3), tmp_path / "f/", size=8, rasterizer=dots, rasterizer_options={"fast": True})


def test_ground_puts_the_person_on_the_floor(static, tmp_path):
    motion = dataclasses.replace(still(1), trans=np.float32([[0, 5, 0]]))
    perform(static, motion, tmp_path / "high.ply")
    perform(static, motion, tmp_path / "ground.ply", ground=True)
    lowest = {n: -PlyData.read(str(tmp_path / f"{n}.ply"))["vertex"]["y"].max() for n in ("high", "ground")}
    assert lowest["high"] > 3
    assert lowest["ground"] == pytest.approx(0, abs=0.03)  # the soles are sampled


# avatars that are open


def test_an_open_avatar_is_played_as_it_was_opened(static, tmp_path):
    avatar = Avatar(static, reuse=2)
    assert perform(avatar, still(3), tmp_path / "a.ply").frames == 1
    assert perform(avatar, still(3), tmp_path / "a.png", threads=1, **SMALL).frames == 3
    with pytest.raises(WrongValue, match="open already, by tier full: leave `tier`, `reuse` out, or give its bundle"):
        perform(avatar, still(3), tmp_path / "b.png", tier="full", reuse=3, **SMALL)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ply", "a.png"]


def test_an_avatar_that_adapts_reports_its_levels(static, tmp_path):
    report = perform(static, still(12), tmp_path / "f/", budget_ms=1e-3, **SMALL)
    assert report.budget_ms == pytest.approx(1e-3)
    assert sum(level["frames"] for level in report.levels) == 12
    avatar = AdaptiveAvatar(read_bundle(static), 10.0)
    assert [level["frames"] for level in perform(avatar, still(3), tmp_path / "f/", **SMALL).levels] == [3]


# where to


def test_by_default_a_video_lies_beside_the_bundle_and_frames_where_none_can_be_written(static, tmp_path, monkeypatch):
    bundle = shutil.copy(static, tmp_path / "anna.gavatar")
    report = perform(bundle, still(2, name="walk"), **SMALL)
    assert report.output == str(tmp_path / "anna_walk.mp4")
    monkeypatch.setattr("gavatar_runtime.play.outputs.video_file.find_encoder", lambda: None)
    report = perform(Avatar(bundle), still(2, name="walk"), **SMALL)
    assert (tmp_path / "anna_walk" / "000001.png").exists()
    takes = f"takes OpenCV ({video_encoder.INSTALL}) or a program ffmpeg"
    assert report.notes == (f"{tmp_path}/anna_walk/ is a folder of numbered .png frames: an .mp4 video {takes}",)


@pytest.mark.parametrize("available", [False, True])
def test_a_slow_rasterizer_is_noted_where_it_was_not_chosen(static, tmp_path, monkeypatch, available):
    if available and not native_library.available()[0]:
        pytest.skip(native_library.available()[1])
    if not available:
        monkeypatch.setattr(native, "available", lambda: (False, "the kernel was not compiled"))
    report = perform(static, still(1), tmp_path / "a.png", size=8)
    assert report.rasterizer == ("NativeRasterizer" if available else "NumpyRasterizer")
    slow = "rasterizer numpy, for native (exact, compiled, many times faster than numpy) is missing: the kernel was not"
    assert report.notes == (() if available else (f"{slow} compiled",))
    assert perform(static, still(1), tmp_path / "a.png", size=8, rasterizer="numpy").notes == ()
    assert perform(static, still(1), tmp_path / "a.ply").notes == ()  # nothing is drawn


# mistakes


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"fps": 0}, "`fps=0`: give a positive number"),
        ({"size": 0}, "`size=0`"),
        ({"orbit": -1}, "`orbit=-1`"),
        ({"background": "mauve"}, "`background=mauve`"),
        ({"frames": slice(9, None)}, "`frames` leaves no frame"),
        ({"camera": "behind"}, "unknown camera 'behind'"),
        ({"tier": "full", "min_psnr": 30}, "`tier` names a tier"),
        ({"gaussians": 0}, "`gaussians=0`: give a whole number from 1 up"),
    ],
)
def test_a_mistake_is_a_value_error_that_names_the_keyword_and_writes_nothing(static, tmp_path, given, message):
    with pytest.raises(ValueError, match=message) as raised:
        perform(static, still(3), tmp_path / "a.png", **{**SMALL, **given})
    assert isinstance(raised.value, UserError)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("given", [{"seen_only": True}, {"gaussians": "auto"}])
def test_an_output_of_gaussians_decodes_for_no_camera(static, tmp_path, given):
    with pytest.raises(WrongValue, match=r"goes by what a camera sees, and .*a\.ply takes all Gaussians"):
        perform(static, still(1), tmp_path / "a.ply", **given)


def test_every_option_of_the_command_is_a_keyword():
    """The command hands its arguments over by their names."""
    options = {action.dest for action in parser()._actions if action.dest != "help"} - set(OURS)
    keywords = set(inspect.signature(perform).parameters)
    assert options <= keywords
    assert keywords - options == {
        "avatar", "motion", "out", "rasterizer_options", "output_options", "progress", "tell", "place", "beside"
    }  # fmt: skip
