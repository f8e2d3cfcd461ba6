"""Which part of a motion is played, how the person is looked at, and how they are decoded."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import DEMO

from gavatar_runtime.avatar.adaptive import AdaptiveAvatar
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle, write_bundle
from gavatar_runtime.decoding.detail import count_for_size
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.formats.camera_file import read_camera
from gavatar_runtime.play.framing import frame_motion, size_on_screen
from gavatar_runtime.play.staging import Clip, Level, Shot, color_from, differing
from gavatar_runtime.values.camera import Camera, look_at

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import make_bundle, manifest, members, still


@pytest.fixture(scope="module")
def fine(tmp_path_factory):
    """More Gaussians than a small image shows."""
    return read_bundle(make_bundle(tmp_path_factory.mktemp("fine") / "fine.gavatar", 160 * 160))


# the part of a motion


def counted(frames=10, fps=30.0):
    motion = still(frames, fps=fps)
    motion.trans[:, 0] = np.arange(frames)
    return motion


def numbers(clip: Clip, motion) -> list[float]:
    return clip.of(motion).trans[:, 0].tolist()


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        (slice(2, 5), [2, 3, 4]),
        (slice(None, None, 4), [0, 4, 8]),
        (slice(-1, None), [9]),
        (slice(5, 99), [5, 6, 7, 8, 9]),
    ],
)
def test_frames_are_chosen_like_a_python_slice(frames, expected):
    assert numbers(Clip(frames=frames), counted()) == expected


def test_a_choice_that_leaves_no_frame_is_refused():
    with pytest.raises(WrongValue, match="leaves no frame: motion 'still' has 10"):
        Clip(frames=slice(10, None)).of(still(10))


def test_seconds_repeat_or_cut_a_motion_and_fps_resamples_it():
    assert numbers(Clip(seconds=0.5), counted()) == [*range(10), *range(5)]
    assert len(Clip(seconds=0.1).of(still(10))) == 3
    assert len(Clip(seconds=1e-5).of(still(10))) == 1
    assert len(Clip(seconds=1).of(still(1))) == 30
    assert numbers(Clip(fps=15), counted()) == [0, 2, 4, 6, 8]
    assert Clip().of(still(240, fps=120)).fps == 30
    assert Clip().of(still(3, fps=10)).fps == 10


def test_frames_are_counted_after_resampling_and_repeating():
    assert numbers(Clip(fps=15, seconds=1, frames=slice(4, 7)), counted()) == [8, 0, 2]


# how the person is looked at


def test_the_size_not_given_is_as_long_as_what_is(static):
    avatar, motion = Avatar(static), still(2)

    def size(**given):
        (camera, other) = Shot(**given).cameras(avatar, motion)
        assert camera is other
        return camera.width, camera.height

    assert size() == (512, 512)
    assert size(size=24) == (24, 24)
    assert size(size=24, width=10) == (10, 24)
    assert size(height=7) == (7, 7)
    assert size(width=31, height=17) == (31, 17)


@pytest.mark.parametrize(
    ("camera", "azimuth"), [("front", 0), ("left", 90), ("back", 180), (45, 45), ("-30", -30), (np.float32(12.5), 12.5)]
)
def test_a_direction_is_a_name_or_degrees(static, camera, azimuth):
    avatar, motion = Avatar(static), still(2)
    framed = frame_motion(avatar, motion, 64, 64, azimuth=azimuth)
    np.testing.assert_array_equal(
        Shot(size=64, camera=camera).cameras(avatar, motion)[0].T_camera_world, framed.T_camera_world
    )


def test_a_stored_camera_keeps_its_size_unless_another_is_asked_for(static):
    avatar, motion, file = Avatar(static), still(2), f"{DEMO / 'cameras.json'}:cam1"
    read = Shot(camera=file).cameras(avatar, motion)[0]
    given = Shot(camera=read_camera(file)).cameras(avatar, motion)[0]
    for camera in (read, given):
        assert (camera.width, camera.height, camera.fx) == (256, 256, read_camera(file).fx)
        np.testing.assert_array_equal(camera.T_camera_world, read_camera(file).T_camera_world)
    smaller = Shot(camera=file, width=64, height=32).cameras(avatar, motion)[0]
    assert (smaller.width, smaller.height) == (64, 32)


def test_an_orbit_goes_once_round_in_the_clip_or_in_its_seconds(static):
    avatar, motion = Avatar(static), still(8, fps=4)
    whole = Shot(size=16, orbit=True).cameras(avatar, motion)
    half = Shot(size=16, orbit=4.0).cameras(avatar, motion)  # two seconds of the four
    assert len(whole) == len(half) == 8
    np.testing.assert_allclose(whole[2].T_camera_world, half[4].T_camera_world, atol=1e-12)  # one matrix product
    np.testing.assert_allclose(whole[0].position[1], whole[4].position[1], atol=1e-12)
    assert np.linalg.norm(whole[0].position - whole[4].position) > 1  # the other side
    assert len({id(c) for c in Shot(size=16, orbit=None).cameras(avatar, motion)}) == 1


@settings(max_examples=30)
@given(st.tuples(*[st.floats(0, 1)] * 3))
def test_a_background_can_be_given_in_numbers(color):
    assert color_from(color) == color
    assert color_from(",".join(repr(c) for c in color)) == color


@pytest.mark.parametrize(
    ("text", "color"), [("white", (1, 1, 1)), ("#00ff80", (0, 1, 128 / 255)), ("Black", (0, 0, 0))]
)
def test_a_background_can_be_named(text, color):
    assert color_from(text) == Shot(background=text).color == color


# how they are decoded


def test_the_level_of_detail_goes_by_the_size_in_the_images(fine):
    motion, view = still(2), Shot(size=96)
    avatar = Level(gaussians="auto").open(fine, Clip(), view, motion)
    body = Avatar(fine, tier=None)
    assert len(avatar) == count_for_size(body.surface, size_on_screen(body, motion, view.cameras(body, motion)))
    assert len(avatar) < len(body)
    assert len(Level(gaussians="auto").open(fine, Clip(), Shot(size=4096), motion)) == len(body)  # large: all there are


def test_a_side_of_the_atlas_is_told_in_gaussians(fine):
    level, note = Level(uv=64).in_gaussians(fine)
    assert note == f"`uv=64` is the former way to say `gaussians={level.gaussians}`"
    assert len(Level(uv=64).open(fine, Clip(), Shot(size=96), still(2))) == level.gaussians
    assert Level(uv="auto").in_gaussians(fine) == (Level(gaussians="auto"), "")
    assert Level(gaussians=7).in_gaussians(fine) == (Level(gaussians=7), "")


def test_a_budget_opens_an_avatar_that_adapts(static):
    avatar = Level(budget_ms=5, threads=1).open(read_bundle(static), Clip(), Shot(), still(2))
    assert isinstance(avatar, AdaptiveAvatar)
    assert avatar.budget_s == 0.005


def test_seen_only_is_refused_where_nothing_can_be_left_out(static):
    with pytest.raises(WrongValue, match="`seen_only`: tier full has nothing to leave out"):
        Level(seen_only=True).open(read_bundle(static), Clip(), Shot(), still(2))
    with pytest.raises(WrongValue, match=r"`seen_only`: .*leave `reuse` out"):
        Level(seen_only=True, reuse=2).open(read_bundle(static), Clip(), Shot(), still(2))


def test_the_rate_of_the_clip_chooses_a_tier_unless_decodes_are_reused(tmp_path):
    tiers = [{"name": "faster", "frame_ms": 1.0, "worst_psnr_capture": 30.0, "psnr_capture": 33.0}]
    write_bundle(tmp_path / "a.gavatar", dataclasses.replace(manifest(), tiers=tiers), members())
    measured = read_bundle(tmp_path / "a.gavatar")
    with pytest.raises(UserError, match="unknown tier 'faster'"):  # it is described, and not in there
        Level().open(measured, Clip(fps=30), Shot(), still(2))
    for level, clip in ((Level(reuse=2), Clip(fps=30)), (Level(), Clip()), (Level(tier="full"), Clip(fps=30))):
        assert level.open(measured, clip, Shot(), still(2)).tier == "full"


# what is refused, and what is not the default


@pytest.mark.parametrize(
    ("kind", "given", "message"),
    [
        (Clip, {"fps": 0}, "`fps=0`: give a positive number"),
        (Clip, {"fps": float("nan")}, "`fps=nan`"),
        (Clip, {"seconds": float("inf")}, "`seconds=inf`"),
        (Shot, {"size": 0}, "`size=0`: give a whole number from 1 up"),
        (Shot, {"width": 2.5}, "`width=2.5`"),
        (Shot, {"height": True}, "`height=True`"),
        (Shot, {"size": 8193}, "`size=8193`: at most 8192"),
        (Shot, {"orbit": -1.0}, "`orbit=-1`"),
        (Shot, {"background": "mauve"}, "`background=mauve`: give white"),
        (Shot, {"background": (1, 2, 3)}, "between 0 and 1"),
        (Shot, {"background": (0.0, 1.0)}, "between 0 and 1"),
        (Shot, {"background": "nan,0,0"}, "between 0 and 1"),
        (Level, {"min_psnr": -1}, "`min_psnr=-1`"),
        (Level, {"target_fps": 0}, "`target_fps=0`"),
        (Level, {"budget_ms": float("nan")}, "`budget_ms=nan`"),
        (Level, {"uv": 0}, "`uv=0`"),
        (Level, {"gaussians": 0}, "`gaussians=0`"),
        (Level, {"gaussians": 5, "uv": 64}, "`gaussians` and `uv` both"),
        (Level, {"uv": "big"}, "`uv=big`: give a whole number from 1 up"),
        (Level, {"reuse": 2.0}, r"`reuse=2\.0`: give a whole number from 1 up"),
        (Clip, {"fps": "30"}, "`fps=30`: give a positive number"),
        (Level, {"reuse": 0}, "`reuse=0`"),
        (Level, {"threads": -2}, "`threads=-2`"),
        (Level, {"budget_ms": 5, "uv": 64}, "leave `gaussians`, `uv`, `reuse` and `seen_only` out"),
        (Level, {"budget_ms": 5, "reuse": 2}, "leave `gaussians`, `uv`, `reuse` and `seen_only` out"),
    ],
)
def test_a_wrong_value_is_refused_at_once_by_its_keyword(kind, given, message):
    with pytest.raises(WrongValue, match=message) as raised:
        kind(**given)
    assert isinstance(raised.value, ValueError)


@pytest.mark.parametrize("camera", ["behind", "nan", "1e9", "", None])
def test_an_unknown_camera_is_refused_with_the_choices(static, camera):
    with pytest.raises(WrongValue, match=r"unknown camera .*choose from: back, front, left, right"):
        Shot(camera=camera).cameras(Avatar(static), still(1))


def test_the_values_that_differ_are_named_even_where_they_cannot_be_compared():
    assert differing(Shot()) == differing(Clip()) == differing(Level()) == []
    camera = Camera(4, 4, 4.0, 4.0, 2.0, 2.0, look_at((0, 0, 3), (0, 0, 0)))
    view = Shot(size=3, camera=camera, background=np.array([0.0, 0.5, 1.0]))
    assert differing(view) == ["size", "camera", "background"]
    assert view.color == (0, 0.5, 1)
    assert differing(Level(reuse=2, tier="full")) == ["tier", "reuse"]
