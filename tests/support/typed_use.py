"""What a program does with the two faces, and the types that it gets: read by mypy, never run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from typing_extensions import assert_type

import gavatar
import gavatar_runtime as gr
from gavatar.capture.capture import Capture
from gavatar.config import TrainConfig
from gavatar.evaluation.result import Evaluation
from gavatar_runtime.bundle import Manifest
from gavatar_runtime.play.outputs.output import FrameFormat
from gavatar_runtime.play.performance import PlayReport


def play(bundle: Path) -> None:
    avatar = gr.load(bundle, tier="full", threads=1)
    assert_type(avatar, gr.Avatar)
    assert_type(avatar.tiers, tuple[str, ...])
    assert_type(avatar.renderer, gr.Renderer)
    camera = gr.Camera(64, 48, 60.0, 60.0, 32.0, 24.0, gr.look_at((0, 1, 3), (0, 1, 0)))
    pose = np.zeros((24, 3), np.float32)
    gaussians = avatar.gaussians(pose, camera=camera, transl=np.zeros(3))
    assert_type(gaussians, gr.Gaussians)
    assert_type(avatar.render(pose, "left", size=64, background=(0, 0, 0)), np.ndarray)
    assert_type(avatar.renderer.draw(pose, camera), gr.Rendering)
    motion = gr.read_motion("wave", waves=3)
    assert_type(motion, gr.Motion)
    assert_type(motion.resampled(25), gr.Motion)
    assert_type(avatar.play(motion, "wave.mp4", fps=30), PlayReport)
    avatar.save("still.ply", pose)
    with_frames = gr.open_output("frames/", FrameFormat(30.0, 64, 48))
    assert_type(with_frames.notes, list[str])


def train(video: Path) -> None:
    prepared = gavatar.prepare(video, "captures/anna", height=1.72)
    assert_type(prepared, gavatar.PreparedCapture)
    run = gavatar.train(prepared, "demo", out="runs/anna", encoder="none")
    assert_type(run, gavatar.TrainedRun)
    assert_type(gavatar.open_run("runs/anna", 1), gavatar.TrainedRun)
    assert_type(run.evaluate(["test"], fit_steps=0), Evaluation)
    assert_type(run.config, TrainConfig)
    exported = run.export("anna.gavatar", tiers=["full"], uv=128)
    assert_type(exported, gavatar.ExportedAvatar)
    assert_type(exported.manifest, Manifest)
    assert_type(gr.load(exported), gr.Avatar)
    capture = gavatar.open_capture(video.parent)
    assert_type(capture, Capture)
    assert_type(gavatar.train(capture), gavatar.TrainedRun)
