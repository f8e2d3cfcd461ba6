"""The player's frame loop and the command `gavatar-play`."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import DEMO, ROOT
from video_frames import frames_of

from gavatar_runtime import native_library
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.cli import play as command
from gavatar_runtime.cli.play_arguments import color_from, frame_slice
from gavatar_runtime.cli.settings import parse_settings
from gavatar_runtime.components import Component, NoOptions, Registry
from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import frame_motion, orbit
from gavatar_runtime.play.player import WARM_UP, Timings, play
from gavatar_runtime.play.staging import clip
from gavatar_runtime.play.writers import open_writer
from gavatar_runtime.render.choice import build_rasterizer, player_rasterizers
from gavatar_runtime.render.pixels import to_bytes
from gavatar_runtime.render.rasterizers import PLAYER_RASTERIZERS, Rasterizer
from gavatar_runtime.values.gaussians import Rendering

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import make_bundle, still


class Dots(Rasterizer):
    """A stand-in for a rasterizer: the pixel of each mean takes its colour. Keeps what it was given."""

    def __init__(self, config=None, fail_at=None):
        self.cameras, self.fail_at, self.stage_seconds = [], fail_at, {}

    def render(self, gaussians, camera, background):
        if self.fail_at == len(self.cameras):
            raise RuntimeError("out of colour")
        self.cameras.append(camera)
        image = np.tile(np.float32(background), (camera.height, camera.width, 1))
        x, y, z = camera.project(gaussians.means).T
        inside = (z > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        image[y[inside].astype(int), x[inside].astype(int)] = gaussians.colors[inside]
        self.stage_seconds = {"project": 0.25, "sort": 0.25, "blend": 0.5}
        return Rendering(image, np.ones(image.shape[:2]), np.ones(image.shape[:2]))


@pytest.fixture(scope="module")
def static(tmp_path_factory):
    return make_bundle(tmp_path_factory.mktemp("static") / "tester.gavatar")


@pytest.fixture(scope="module")
def dynamic(tmp_path_factory):
    return make_bundle(tmp_path_factory.mktemp("dynamic") / "tester.gavatar", dynamic=True)


@pytest.fixture(autouse=True)
def dots(monkeypatch):
    """The stand-in is registered as `dots` for the length of a test."""
    monkeypatch.setitem(PLAYER_RASTERIZERS._components, "dots", Component("dots", Dots, NoOptions, "", __name__))


# the loop and its timings


def test_every_frame_is_rendered_with_its_camera_and_written(static, tmp_path):
    avatar, rasterizer = Avatar(static), Dots()
    motion, _ = avatar.fit(read_motion("turn", seconds=1, fps=5))
    cameras = orbit(frame_motion(avatar, motion, 40, 30), np.zeros(3), np.arange(5) / 5)
    writer = open_writer(tmp_path / "frames", width=40, height=30, fps=5)
    calls = []
    timings = play(avatar, motion, cameras, rasterizer, writer, progress=lambda *c: calls.append(c))
    assert rasterizer.cameras == cameras
    assert calls == [(i, 5) for i in range(1, 6)]
    assert sorted(p.name for p in (tmp_path / "frames").iterdir()) == [f"{i:06d}.png" for i in range(5)]
    assert list(timings.stages) == ["encode", "decode", "skin", "project", "sort", "blend", "other", "write"]
    assert all(len(v) == 5 for v in timings.stages.values())
    expected = Dots().render(avatar.gaussians(motion.poses[3], motion.trans[3]), cameras[3], (1, 1, 1)).color
    got = cv2.imread(str(tmp_path / "frames" / "000003.png"))[..., ::-1]
    np.testing.assert_array_equal(got, to_bytes(expected))


def test_a_rasterizer_that_draws_bytes_into_one_buffer_is_played_as_it_is(static, tmp_path):
    class Bytes(Rasterizer):
        def __init__(self):
            self.buffer, self.stage_seconds = np.zeros((4, 4, 3), np.uint8), {}

        def render_uint8(self, gaussians, camera, background):
            self.buffer += 1
            return self.buffer

    avatar, motion = Avatar(static), still(3)
    writer = open_writer(tmp_path / "s.png", width=4, height=4, fps=1)
    play(avatar, motion, frame_motion(avatar, motion, 4, 4), Bytes(), writer)
    assert cv2.imread(str(tmp_path / "s.png"))[0, ::4, 0].tolist() == [1, 2, 3]


@pytest.mark.parametrize("name", ["a.mp4", "a.png", "frames/"])
def test_when_rendering_fails_nothing_is_left_behind(static, tmp_path, name):
    avatar = Avatar(static)
    motion = still(5)
    writer = open_writer(f"{tmp_path}/{name}", width=32, height=32, fps=30)
    with pytest.raises(RuntimeError, match="out of colour"):
        play(avatar, motion, frame_motion(avatar, motion, 32, 32), Dots(fail_at=2), writer)
    assert list(tmp_path.iterdir()) == []


def test_the_number_of_cameras_must_be_that_of_the_frames(static, tmp_path):
    avatar, motion = Avatar(static), still(3)
    camera = frame_motion(avatar, motion, 8, 8)
    with pytest.raises(ValueError, match="2 cameras for 3 frames"):
        play(avatar, motion, [camera] * 2, Dots(), open_writer(tmp_path / "f", width=8, height=8, fps=1))


def test_medians_leave_the_warm_up_and_the_frame_rate_leaves_the_writing_out():
    timings = Timings()
    for _ in range(WARM_UP):
        timings.add({"blend": 100.0, "skin": 100.0, "write": 100.0})
    for _ in range(5):
        timings.add({"blend": 0.03, "skin": 0.01, "write": 7.0})
    assert timings.medians() == {"blend": 0.03, "skin": 0.01, "write": 7.0}
    assert timings.frames_per_second == pytest.approx(25)


def test_timings_of_one_frame_and_of_none():
    timings = Timings()
    assert len(timings) == 0
    assert np.isnan(timings.frame_seconds)
    timings.add({"blend": 0.5, "write": 1.0})
    assert timings.frames_per_second == pytest.approx(2)


# the command


def clipped(motion, text=None, fps=None, seconds=None):
    frames = None if text is None else frame_slice(text)
    return clip(motion, fps, seconds, frames)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2:5", [2, 3, 4]),
        (":2", [0, 1]),
        ("8:", [8, 9]),
        ("::4", [0, 4, 8]),
        ("3", [3]),
        ("-1", [9]),
        ("5:99", [5, 6, 7, 8, 9]),
    ],
)
def test_frames_are_chosen_like_a_python_slice(text, expected):
    motion = still(10)
    motion.trans[:, 0] = np.arange(10)
    assert clipped(motion, text).trans[:, 0].tolist() == expected


def test_a_choice_that_leaves_no_frame_is_refused():
    with pytest.raises(UserError, match="leaves no frame: motion 'still' has 10"):
        clipped(still(10), "10:")


def test_seconds_repeat_or_cut_a_motion_and_fps_resamples_it():
    motion = still(10)
    motion.trans[:, 0] = np.arange(10)
    assert clipped(motion, seconds=0.5).trans[:, 0].tolist() == [*range(10), *range(5)]
    assert len(clipped(motion, seconds=0.1)) == 3
    assert len(clipped(still(1), seconds=1)) == 30
    assert clipped(motion, fps=15).trans[:, 0].tolist() == [0, 2, 4, 6, 8]
    assert clipped(still(240, fps=120)).fps == 30
    assert clipped(still(3, fps=10)).fps == 10


def test_settings_go_to_their_group():
    options = parse_settings(["motion.waves=3", "motion.seconds=1.5", "rasterizer.fast=true", "motion.up=z"])
    assert options == {"motion": {"waves": 3, "seconds": 1.5, "up": "z"}, "rasterizer": {"fast": True}}
    for setting in ("waves=3", "motion.waves", "encoder.x=1"):
        with pytest.raises(UserError, match="--set"):
            parse_settings([setting])


@settings(max_examples=30)
@given(st.tuples(*[st.floats(0, 1)] * 3))
def test_a_background_can_be_given_in_numbers(color):
    assert color_from(",".join(repr(c) for c in color)) == color


@pytest.mark.parametrize(
    ("text", "color"), [("white", (1, 1, 1)), ("#00ff80", (0, 1, 128 / 255)), ("Black", (0, 0, 0))]
)
def test_a_background_can_be_named(text, color):
    assert color_from(text) == color


def run(*arguments):
    """The command in this process -> its exit code."""
    with pytest.raises(SystemExit) as raised:
        command.main([str(a) for a in arguments])
    return raised.value.code


@pytest.fixture
def played(static, tmp_path):
    """`played(*arguments, out=NAME)` -> exit code, with small images and the stand-in."""

    def play_it(*arguments, out="out.mp4", bundle=static, size=("--size", 24)):
        return run(bundle, "--rasterizer", "dots", "--out", f"{tmp_path}/{out}", *size, *arguments)

    return play_it


def test_a_video_comes_out_with_its_timings(played, tmp_path, capsys):
    assert played("--motion", "wave", "--frames", "0:5", "--json", tmp_path / "t.json") == 0
    assert len(frames_of(tmp_path / "out.mp4")) == 5
    report = json.loads((tmp_path / "t.json").read_text())
    assert (report["frames"], report["width"], report["gaussians"], report["motion"]) == (5, 24, 300, "wave")
    assert {"encode", "decode", "skin"} < set(report["stage_ms"])
    assert report["frames_per_second"] == pytest.approx(1e3 / report["frame_ms"])
    printed = capsys.readouterr()
    assert "frames per second" in printed.out
    assert printed.err == ""


def test_the_person_is_in_the_picture_and_the_rest_is_background(played, tmp_path):
    assert played("--motion", "turn", "--frames", "0", "--background", "#0000ff", out="s.png", size=("--size", 64)) == 0
    image = cv2.imread(str(tmp_path / "s.png"))[..., ::-1]
    blue = (image == (0, 0, 255)).all(-1)
    assert blue[0].all()
    assert blue[:, 0].all()
    assert 0.03 < (~blue).mean() < 0.6
    assert not blue[24:40, 29:35].all()


@pytest.mark.parametrize("size", [("--size", 1), ("--width", 31, "--height", 17), ("--width", 7)])
def test_odd_sizes_and_one_pixel_play(played, tmp_path, size):
    assert played("--frames", "0:2", size=size) == 0
    assert len(frames_of(tmp_path / "out.mp4")) == 2


def test_a_motion_of_one_frame_plays_everywhere(played, tmp_path):
    np.savez(tmp_path / "m.npz", poses=np.zeros((1, 66)), mocap_framerate=30.0)
    for out in ("a.mp4", "f/", "s.png"):
        assert played("--motion", tmp_path / "m.npz", out=out) == 0
        assert (tmp_path / out).exists()


def test_a_dynamic_bundle_an_orbit_and_an_unpacked_bundle_play(played, dynamic, tmp_path):
    with zipfile.ZipFile(dynamic) as file:
        file.extractall(tmp_path / "unpacked")
    assert played("--orbit", "--frames", "::60", out="a/", bundle=tmp_path / "unpacked") == 0
    assert played("--orbit", "2", "--camera", "left", "--frames", "::60", out="b/", bundle=dynamic) == 0
    assert len(list((tmp_path / "a").iterdir())) == 3


def test_the_camera_of_a_capture_gives_its_own_size_or_the_one_asked_for(played, tmp_path):
    camera = f"{DEMO / 'cameras.json'}:cam0"
    assert played("--camera", camera, "--frames", "0", out="a.png", size=()) == 0
    assert cv2.imread(str(tmp_path / "a.png")).shape == (256, 256, 3)
    assert played("--camera", camera, "--frames", "0", out="b.png", size=("--width", 20, "--height", 10)) == 0
    assert cv2.imread(str(tmp_path / "b.png")).shape == (10, 20, 3)


def test_by_default_the_video_lies_next_to_the_bundle(tmp_path):
    bundle = make_bundle(tmp_path / "anna.gavatar", 20)
    assert run(bundle, "--size", 16, "--frames", "0:2", "--rasterizer", "dots", "--quiet") == 0
    assert (tmp_path / "anna_turn.mp4").exists()


def test_joints_that_the_body_lacks_are_reported(played, tmp_path, capsys):
    np.savez(tmp_path / "m.npz", poses=np.full((1, 72), 0.1), mocap_framerate=30.0)
    assert played("--motion", tmp_path / "m.npz", out="s.png") == 0
    assert "the body has no left_hand, right_hand; the motion's are ignored" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--motion", "waev"], "unknown motion 'waev'.*did you mean 'wave'"),
        (["--motion", "absent.npz"], r"absent\.npz does not exist"),
        (["--rasterizer", "dotz"], "unknown rasterizer 'dotz'.*did you mean 'dots'"),
        (["--camera", "behind"], "unknown camera 'behind'"),
        (["--camera", "nan"], "unknown camera 'nan'"),
        (["--camera", "absent.json:cam0"], r"absent\.json does not exist"),
        (["--frames", "9999:"], "leaves no frame"),
        (["--frames", "a:b"], "not A:B"),
        (["--frames", "0:9:0"], "not A:B"),
        (["--size", "0"], "whole number from 1 up"),
        (["--size", "999999"], "at most 8192"),
        (["--fps", "0"], "not a positive number"),
        (["--fps", "nan"], "not a positive number"),
        (["--threads", "-2"], "whole number from 1 up"),
        (["--background", "mauve"], "mauve.*white"),
        (["--background", "1,2,3"], "between 0 and 1"),
        (["--set", "motion.wavs=2"], "no option 'wavs'"),
        (["--set", "rasterizer.wavs=2"], "no option 'wavs'"),
        (["--out", "video.avi"], r"cannot write 'video\.avi'"),
    ],
)
def test_a_users_mistake_is_exit_code_2_and_one_sentence(static, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert run(static, "--rasterizer", "dots", "--frames", "0", *arguments) == 2
    printed = capsys.readouterr()
    assert re.search(message, printed.err)
    assert "Traceback" not in printed.err
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_bundle_and_a_nan_motion_are_mistakes_too(played, tmp_path, capsys):
    (tmp_path / "cut.gavatar").write_bytes(b"PK\x03\x04")
    np.savez(tmp_path / "m.npz", poses=np.full((2, 66), np.nan), mocap_framerate=30.0)
    assert played(bundle=tmp_path / "cut.gavatar") == 2
    assert played(bundle=tmp_path / "absent.gavatar") == 2
    assert played("--motion", tmp_path / "m.npz") == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 3
    assert all(line.startswith("error: ") for line in errors)
    assert not (tmp_path / "out.mp4").exists()


def test_a_pose_whose_numbers_are_absurd_still_plays_or_is_refused_in_words(played, tmp_path):
    poses = np.zeros((2, 66))
    poses[1, 3] = 1e30
    np.savez(tmp_path / "m.npz", poses=poses, mocap_framerate=30.0)
    assert played("--motion", tmp_path / "m.npz") in (0, 2)


# which rasterizer


def test_a_rasterizer_that_takes_threads_is_given_them_and_others_are_not(monkeypatch):
    from gavatar_runtime.render import rasterizers

    registry = Registry("rasterizer")

    @dataclasses.dataclass
    class WithThreads:
        threads: int = 0

    @registry.register("native", config=WithThreads)
    class Absent:
        def __init__(self, config):
            raise UserError("the native kernel is not built")

    @registry.register("many", config=WithThreads)
    class Many:
        def __init__(self, config):
            self.threads = config.threads

    @registry.register("numpy")
    class Plain:
        def __init__(self, config):
            pass

    monkeypatch.setattr(rasterizers, "PLAYER_RASTERIZERS", registry)
    assert build_rasterizer("many", threads=3).threads == 3
    assert build_rasterizer("many", {"threads": 2}, threads=3).threads == 2
    assert isinstance(build_rasterizer("numpy", threads=3), Plain)
    assert build_rasterizer("many", trained={"threads": 4, "fast": True}).threads == 4  # of a manifest: what it knows
    assert build_rasterizer("many", {"threads": 2}, trained={"threads": 4}).threads == 2
    monkeypatch.setattr(native_library, "available", lambda: (False, "the native kernel is not built"))
    assert isinstance(build_rasterizer("auto"), Plain)
    with pytest.raises(UserError, match="not built"):
        build_rasterizer("native")


# no torch


NO_TORCH = """
import os
import sys

WALLED = {"torch", "gavatar", "gavatar_plugins", "onnx", "hydra", "scipy", *os.environ.get("WALLED", "").split()}

class Wall:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in WALLED:
            raise ImportError(f"the player must not import {name}")

sys.meta_path.insert(0, Wall())
from gavatar_runtime.cli.play import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert end.code == 0, end.code
assert "torch" not in sys.modules
print("played without torch")
"""


@pytest.mark.parametrize("rasterizer", ["auto", *player_rasterizers().names()])
def test_playing_loads_no_torch(dynamic, tmp_path, rasterizer):
    try:
        build_rasterizer(rasterizer)
    except UserError as error:
        pytest.skip(str(error))
    arguments = [dynamic, "--size", "16", "--frames", "0:2", "--rasterizer", rasterizer, "--out", tmp_path / "o.mp4"]
    done = subprocess.run(
        [sys.executable, "-c", NO_TORCH, *map(str, arguments)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert "played without torch" in done.stdout
    assert len(frames_of(tmp_path / "o.mp4")) == 2


def test_playing_without_opencv_and_ffmpeg_writes_frames_and_sheets(dynamic, tmp_path):
    """As the base install plays. What is written is what an environment with OpenCV writes."""
    bundle = tmp_path / "anna.gavatar"
    bundle.write_bytes(Path(dynamic).read_bytes())

    def play_there(*arguments, walled="cv2"):
        common = [bundle, "--size", "16", "--frames", "0:2", "--set", "rasterizer.resolution=0.5"]
        if native_library.available()[0] is False:
            common = common[:-2]
        return subprocess.run(
            [sys.executable, "-c", NO_TORCH, *map(str, common), *map(str, arguments)],
            capture_output=True, text=True, timeout=120, env={**os.environ, "PATH": "", "WALLED": walled},
        )  # fmt: skip

    done = play_there()
    assert done.returncode == 0, done.stderr
    assert f"note: frames go to {tmp_path}/anna_turn/: to write a video takes OpenCV" in done.stderr
    frames = sorted((tmp_path / "anna_turn").iterdir())
    assert [path.name for path in frames] == ["000000.png", "000001.png"]
    assert play_there("--out", tmp_path / "sheet.png").returncode == 0
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    np.testing.assert_array_equal(sheet, np.concatenate([cv2.imread(str(path)) for path in frames], 1))
    assert play_there("--out", tmp_path / "other.png", walled="").returncode == 0
    assert (tmp_path / "other.png").read_bytes() == (tmp_path / "sheet.png").read_bytes()
    done = play_there("--out", tmp_path / "a.mp4")
    assert "AssertionError: 2" in done.stderr
    assert "error: " in done.stderr
    assert "pip install 'gavatar[video]'" in done.stderr
    assert not (tmp_path / "a.mp4").exists()


def test_help_and_a_mistyped_option_load_neither_numpy_nor_a_network(tmp_path):
    code = "import sys; from gavatar_runtime.cli.play import main\ntry: main(sys.argv[1:])\nexcept SystemExit: pass\n"
    code += "assert not {'numpy', 'cv2', 'onnxruntime'} & set(sys.modules)"
    for arguments in (["--help"], ["a.gavatar", "--sise", "3"]):
        done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr


# the documentation


def test_the_program_in_the_readme_runs(static, monkeypatch):
    monkeypatch.delitem(PLAYER_RASTERIZERS._components, "dots")
    try:
        build_rasterizer()
    except UserError as error:
        pytest.skip(str(error))
    text = (ROOT / "deploy" / "README.md").read_text(encoding="utf-8")
    program = re.search(r"```python\n(.*?)```", text, re.DOTALL).group(1)
    program = (
        program.replace('"anna.gavatar"', repr(str(static)))
        .replace('"wave"', '"wave", seconds=0.1')
        .replace("512", "32")
    )
    names = {}
    exec(program, names)
    assert names["image"].shape == (32, 32, 3)
