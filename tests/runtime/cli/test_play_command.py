"""`gavatar-play`."""

from __future__ import annotations

import json
import re
import shutil
import zipfile

import cv2
import numpy as np
import pytest
from commands import run_play
from places import DEMO
from plyfile import PlyData
from video_frames import frames_of

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.cli.play_arguments import frame_slice
from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.performance import perform

pytestmark = pytest.mark.usefixtures("dots")


@pytest.fixture
def played(static, tmp_path):
    """`played(*arguments, out=NAME)` -> exit code, with small images and the stand-in."""

    def play_it(*arguments, out="out.mp4", bundle=static, size=("--size", 24)):
        return run_play(bundle, "--rasterizer", "dots", "--out", f"{tmp_path}/{out}", *size, *arguments)

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


def test_by_default_the_video_lies_next_to_the_bundle(static, tmp_path):
    bundle = shutil.copy(static, tmp_path / "anna.gavatar")
    assert run_play(bundle, "--size", 16, "--frames", "0:2", "--rasterizer", "dots", "--quiet") == 0
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
        (["--frames", "9999:"], "--frames leaves no frame"),
        (["--frames", "a:b"], "not A:B"),
        (["--frames", "0:9:0"], "not A:B"),
        (["--size", "0"], "--size 0: give a whole number from 1 up"),
        (["--size", "999999"], "--size 999999: at most 8192"),
        (["--fps", "0"], "--fps 0: give a positive number"),
        (["--fps", "nan"], "--fps nan: give a positive number"),
        (["--fps", "fast"], "--fps: invalid float value"),
        (["--threads", "-2"], "--threads -2: give a whole number from 1 up"),
        (["--gaussians", "0"], "--gaussians 0: give a whole number from 1 up"),
        (["--uv", "big"], "--uv/--detail: invalid detail value"),
        (
            ["--budget-ms", "5", "--reuse", "2"],
            "--budget-ms chooses .* leave --gaussians, --uv, --reuse and --seen",
        ),
        (["--seen-only"], "--seen-only: tier full has nothing to leave out"),
        (["--tier", "full", "--min-psnr", "3"], "--tier names a tier, and --min-psnr and --target-fps choose one"),
        (["--orbit", "0"], "--orbit 0: give a positive number"),
        (["--background", "mauve"], "--background mauve: give white"),
        (["--background", "1,2,3"], "between 0 and 1"),
        (["--set", "motion.wavs=2"], "no option 'wavs'"),
        (["--motion", "wave", "--set", "motion.waves=x"], "--set motion.waves=x: give a whole number"),
        (["--set", "output.wavs=2"], "no option 'wavs'"),
        (["--set", "output.shown=0", "--out", "s.png"], "--set output.shown=0: give a whole number"),
        (["--set", "rasterizer.wavs=2"], "no option 'wavs'"),
        (["--out", "video.avi"], r"cannot write 'video\.avi'"),
        (["--output", "vidio"], "unknown output 'vidio'.*did you mean 'video'"),
        (["--out", "a.png", "--output", "ply"], r"output 'ply' cannot write 'a\.png'"),
        (["--out", "a.ply", "--seen-only"], r"--seen-only goes by what a camera sees, and a\.ply takes all Gaussians"),
        (["--out", "a.ply", "--gaussians", "auto"], "--gaussians auto goes by what a camera sees"),
    ],
)
def test_a_users_mistake_is_exit_code_2_and_one_sentence(static, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert run_play(static, "--rasterizer", "dots", "--frames", "0", *arguments) == 2
    printed = capsys.readouterr()
    assert re.search(message, printed.err)
    assert "Traceback" not in printed.err
    assert list(tmp_path.iterdir()) == []


def test_notes_of_a_motion_name_its_options_and_not_those_of_playing(static, tmp_path, capsys):
    """A motion's fps says how fast it was filmed, and --fps resamples it."""
    np.savez(tmp_path / "m.npz", poses=np.zeros((3, 66)), trans=np.zeros((3, 3)))
    common = (static, "--motion", tmp_path / "m.npz", "--rasterizer", "dots", "--size", "16")
    assert run_play(*common, "--out", tmp_path / "a.png", "--json", tmp_path / "a.json") == 0
    sentence = "--set motion.fps=25 (or what it is) says another"
    assert sentence in capsys.readouterr().err
    assert any(sentence in note for note in json.loads((tmp_path / "a.json").read_text())["notes"])
    report = perform(static, tmp_path / "m.npz", tmp_path / "b.png", rasterizer="dots", size=16)
    assert any("`read_motion(..., fps=25)`" in note for note in report.notes)
    np.savez(tmp_path / "m.npz", poses=np.zeros((3, 66)), trans=np.zeros((3, 3)), mocap_framerate=0)
    assert run_play(*common, "--out", tmp_path / "a.png") == 2
    assert "say the rate with --set motion.fps=30" in capsys.readouterr().err
    with pytest.raises(UserError, match=r"say the rate with `read_motion\(\.\.\., fps=30\)`"):
        perform(static, tmp_path / "m.npz", tmp_path / "b.png", rasterizer="dots", size=16)


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


# outputs of Gaussians


def test_the_gaussians_of_a_frame_are_written_without_drawing(played, static, tmp_path, capsys):
    assert played("--motion", "wave", "--frames", "3", "--json", tmp_path / "t.json", out="a.ply", size=()) == 0
    printed = capsys.readouterr()
    report = json.loads((tmp_path / "t.json").read_text())
    assert "a.ply: 1 frame, 300 Gaussians, tier full\n" in printed.out
    assert (report["width"], report["rasterizer"], report["frames"]) == (None, None, 1)
    assert set(report["stage_ms"]) == {"encode", "decode", "skin", "other"}
    avatar = Avatar(static)
    motion, _ = avatar.fit(read_motion("wave"))
    vertices = PlyData.read(str(tmp_path / "a.ply"))["vertex"]
    # 1e-6 m: the player folds joints that rest, which rounds otherwise
    np.testing.assert_allclose(vertices["z"], avatar.gaussians(*motion.at(3)).means[:, 2], atol=1e-6)


def test_options_that_an_output_has_no_use_for_are_named(played, tmp_path, capsys):
    assert played("--frames", "0:2", "--orbit", "--set", "rasterizer.depth=true", out="f/%03d.ply") == 0
    said = capsys.readouterr().err
    assert f"note: {tmp_path}/f/%03d.ply takes the Gaussians, which nothing draws: " in said
    assert "--size, --orbit, --rasterizer had no use" in said
    assert sorted(path.name for path in (tmp_path / "f").iterdir()) == ["000.ply", "001.ply"]
    assert played("--frames", "0:2", "--quiet", out="f/%03d.ply") == 0
    assert capsys.readouterr().err == ""


def test_one_file_of_a_longer_motion_is_noted(played, capsys):
    assert played("--frames", "0:5", out="a.ply", size=()) == 0
    assert "a.ply holds the first of 5 frames" in capsys.readouterr().err


def test_an_output_may_be_chosen_by_name_and_has_a_place_of_its_own(static, tmp_path):
    bundle = shutil.copy(static, tmp_path / "anna.gavatar")
    for name, written in (("ply", "anna_turn.ply"), ("sheet", "anna_turn.png"), ("frames", "anna_turn")):
        arguments = ["--output", name, "--frames", "0", "--quiet"]
        assert run_play(bundle, "--rasterizer", "dots", "--size", 8, *arguments) == 0
        assert (tmp_path / written).exists()


def test_a_sheet_takes_its_options(played, tmp_path):
    options = ["--set", "output.shown=6", "--set", "output.columns=3"]
    assert played("--motion", "turn", *options, out="s.png", size=("--size", 8)) == 0
    assert cv2.imread(str(tmp_path / "s.png")).shape == (16, 24, 3)


# arguments


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
    assert list(range(10))[frame_slice(text)] == expected
