"""The player's frame loop and its timings."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from dots import Dots

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.errors import UserError
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import frame_motion, orbit
from gavatar_runtime.play.outputs import FrameFormat, GaussianOutput, ImageOutput, open_output
from gavatar_runtime.play.outputs.nowhere import Nowhere
from gavatar_runtime.play.player import WARM_UP, Timings, play_gaussians, play_images
from gavatar_runtime.render.pixels import to_bytes
from gavatar_runtime.render.rasterizers import Rasterizer
from gavatar_runtime.render.renderer import Renderer

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from make_bundle import still


def test_every_frame_is_rendered_with_its_camera_and_written(static, tmp_path):
    avatar = Avatar(static)
    renderer = Renderer(avatar, Dots())
    motion, _ = avatar.fit(read_motion("turn", seconds=1, fps=5))
    cameras = orbit(frame_motion(avatar, motion, 40, 30), np.zeros(3), np.arange(5) / 5)
    output = open_output(tmp_path / "frames", FrameFormat(5, 40, 30))
    calls = []
    timings = play_images(renderer, motion, cameras, output, progress=lambda *c: calls.append(c))
    assert renderer.rasterizer.cameras == cameras
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
    output = open_output(tmp_path / "s.png", FrameFormat(1, 4, 4))
    play_images(Renderer(avatar, Bytes()), motion, frame_motion(avatar, motion, 4, 4), output)
    assert cv2.imread(str(tmp_path / "s.png"))[0, ::4, 0].tolist() == [1, 2, 3]


@pytest.mark.parametrize("name", ["a.mp4", "a.png", "frames/"])
def test_when_rendering_fails_nothing_is_left_behind(static, tmp_path, name):
    avatar = Avatar(static)
    motion = still(5)
    output = open_output(f"{tmp_path}/{name}", FrameFormat(30, 32, 32))
    with pytest.raises(RuntimeError, match="out of colour"):
        play_images(Renderer(avatar, Dots(fail_at=2)), motion, frame_motion(avatar, motion, 32, 32), output)
    assert list(tmp_path.iterdir()) == []


def test_the_number_of_cameras_must_be_that_of_the_frames(static):
    avatar, motion = Avatar(static), still(3)
    camera = frame_motion(avatar, motion, 8, 8)
    with pytest.raises(ValueError, match="2 cameras for 3 frames"):
        play_images(Renderer(avatar, Dots()), motion, [camera] * 2, Nowhere())


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


# outputs that take the Gaussians


class Kept(GaussianOutput):
    """Copies what it is given, late: by then the next frames are being decoded."""

    def __init__(self):
        super().__init__(Path())
        self.frames, self.closed, self.discarded = [], False, False

    def add(self, gaussians):
        time.sleep(0.01)
        self.frames.append((gaussians.means.copy(), gaussians.colors.copy(), gaussians.scales.copy()))

    def close(self):
        self.closed = True

    def discard(self):
        self.discarded = True


@pytest.mark.parametrize("pipelined", [False, True])
def test_gaussians_come_whole_and_in_order_and_nothing_is_drawn(dynamic, pipelined):
    avatar = Avatar(dynamic)
    motion, _ = avatar.fit(read_motion("wave", fps=4))
    kept = Kept()
    timings = play_gaussians(avatar, motion, kept, pipelined=pipelined)
    assert kept.closed
    assert list(timings.stages) == ["encode", "decode", "skin", "other", "write"]
    assert len(timings) == len(kept.frames) == len(motion) > 4  # more than the buffers that the avatar has
    other = Avatar(dynamic)
    other.follow(motion)
    for frame, (means, colors, scales) in enumerate(kept.frames):
        expected = other.gaussians(*motion.at(frame))
        np.testing.assert_array_equal(means, expected.means)
        np.testing.assert_array_equal(colors, expected.colors)
        np.testing.assert_array_equal(scales, expected.scales)


def test_an_avatar_that_fails_discards_the_output_and_writes_no_more(static):
    avatar, kept = Avatar(static), Kept()
    motion = still(5)
    motion.poses[2] = np.nan
    with pytest.raises(UserError, match="NaN or infinite"):
        play_gaussians(avatar, motion, kept)
    assert (kept.discarded, kept.closed) == (True, False)
    assert len(kept.frames) <= 2


def test_an_output_that_fails_ends_the_playing_with_its_error(static):
    class Full(ImageOutput):
        def add(self, image):
            raise UserError("the disk is full")

        def close(self):
            raise AssertionError("nothing was written")

        def discard(self):
            pass

    avatar, motion = Avatar(static), still(4)
    with pytest.raises(UserError, match="the disk is full"):
        play_images(Renderer(avatar, Dots()), motion, frame_motion(avatar, motion, 8, 8), Full(Path()))


def test_an_output_that_wants_no_frame_is_closed(static):
    class Nothing(Kept):
        def choose(self, count):
            return []

    output = Nothing()
    assert len(play_gaussians(Avatar(static), still(3), output)) == 0
    assert output.closed
