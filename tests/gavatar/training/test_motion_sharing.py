"""Neighbouring frames share what an image says of the motion."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tiny_capture import SMALL, write_tiny_capture

from gavatar.config import MotionConfig, check, compose_config
from gavatar.losses import LossInputs
from gavatar.training.motion_table import MotionTable, RowAdam, scale_gradient, shared_frames
from gavatar.training.run import train
from gavatar.training.schedule import sharing_width
from gavatar.training.trainer import Trainer
from gavatar_runtime.errors import UserError
from gavatar_runtime.values.motion import Motion


def test_frames_take_part_by_their_distance_in_time():
    times = torch.tensor([0.0, 0.1, 0.2, 0.29, 5.0])
    rows, kernel = shared_frames(times, torch.tensor([1]), 0.1)
    assert rows.tolist() == [0, 1, 2, 3]  # within two widths; what lies across the gap is left alone
    shares = np.exp(-0.5 * np.array([1, 0, 1, 1.9]) ** 2)
    assert kernel[:, 1].numpy() == pytest.approx(shares, rel=1e-5)  # float32 times
    assert not kernel[:, [0, 2, 3]].any()  # they say nothing, they were not shown


def test_the_width_is_in_seconds_whatever_the_frame_rate():
    for fps in (15, 30, 60):
        times = torch.arange(4 * fps) / fps
        rows, _ = shared_frames(times, torch.tensor([2 * fps]), 0.4)
        assert (times[rows[-1]] - times[rows[0]]).item() == pytest.approx(1.6, abs=1.5 / fps)


@pytest.mark.parametrize(
    ("times", "shown", "width", "expected"),
    [([3.0], [0], 0.5, [0]), ([0.0, 0.1], [1], 0.5, [0, 1]), ([0.0, 9.0], [0], 0.5, [0]), ([0.0, 0.1], [1], 0.0, [1]),
     ([0.0, 0.1, 0.2], [2, 0], 0.0, [2, 0]), ([0.0, 0.0], [0], 1e-9, [0, 1]), ([0.0, 1.0], [], 1.0, [])],
)  # fmt: skip
def test_one_frame_two_frames_gaps_and_no_width(times, shown, width, expected):
    at = torch.tensor(shown, dtype=torch.long)
    if not shown:
        with pytest.raises(ValueError, match="at least one"):
            shared_frames(torch.tensor(times), at, width)
        return
    rows, kernel = shared_frames(torch.tensor(times), at, width)
    assert rows.tolist() == expected
    assert torch.isfinite(kernel).all()
    mine = [expected.index(s) for s in shown]
    assert (kernel[mine, mine] == 1).all()


def test_the_step_is_adam_on_the_smoothed_gradient():
    generator = torch.Generator().manual_seed(0)
    start = torch.randn(6, 2, 3, generator=generator)
    ours, theirs = torch.nn.Parameter(start.clone()), torch.nn.Parameter(start.clone())
    rows, kernel = shared_frames(torch.arange(6) / 15, torch.tensor([0, 3]), 0.3)
    assert len(rows) == 6
    row_adam = RowAdam([ours], lr=0.1, betas=(0.9, 0.99), eps=1e-8)
    adam = torch.optim.Adam([theirs], lr=0.1, betas=(0.9, 0.99), eps=1e-8)
    for _ in range(5):
        gradient = torch.randn(6, 2, 3, generator=generator)
        ours.grad = gradient.clone()
        theirs.grad = torch.einsum("ab,bjc->ajc", kernel, gradient) + gradient / 2
        row_adam.step(rows, kernel, {ours: gradient / 2})
        adam.step()
    # the same sums in another order: float32 roundings over five steps
    assert torch.allclose(ours, theirs, atol=1e-5)


def test_sharing_finds_a_smooth_error_that_frames_alone_have_no_time_to_find():
    """What the option is for, without a renderer: each step shows 4 of 120 frames through noisy gradients."""
    errors = {}
    for width in (0.0, 0.4):
        generator = torch.Generator().manual_seed(0)
        times = torch.arange(120) / 15
        wanted = 0.2 * torch.sin(2 * np.pi * times / 4)[:, None, None] * torch.ones(1, 5, 3)
        found = torch.nn.Parameter(torch.zeros(120, 5, 3))
        optimizer = RowAdam([found], lr=0.01)
        for _ in range(200):
            shown = torch.randperm(120, generator=generator)[:4]
            found.grad = torch.zeros_like(found)
            noise = 0.1 * torch.randn(4, 5, 3, generator=generator)
            found.grad[shown] = found.detach()[shown] - wanted[shown] + noise
            optimizer.step(*shared_frames(times, shown, width))
        errors[width] = (found.detach() - wanted).square().mean().sqrt().item()
    assert errors[0.4] < 0.5 * errors[0.0]


def test_the_width_narrows_over_the_stage():
    motion = MotionConfig(sharing=0.8, sharing_final=0.2, sharing_end=0.5)
    assert [sharing_width(motion, p) for p in (0.0, 0.25, 0.5, 1.0)] == pytest.approx([0.8, 0.5, 0.2, 0.2])
    assert sharing_width(MotionConfig(sharing=0.8, sharing_final=0.0, sharing_end=0.0), 0.0) == 0


def test_a_short_capture_is_not_corrected_as_one_frame():
    motion = MotionConfig(sharing=0.8, sharing_final=0.5, sharing_end=0.5)
    # 1.6 seconds: an eighth is 0.2, at the start and at the end
    assert [sharing_width(motion, p, 1.6) for p in (0.0, 0.25, 1.0)] == pytest.approx([0.2, 0.2, 0.2])
    assert sharing_width(motion, 0.0, 100.0) == 0.8
    assert sharing_width(motion, 0.0, 0.0) == 0  # one frame


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_an_impossible_width_is_refused(value):
    with pytest.raises(UserError, match=r"motion\.sharing must be"):
        check(compose_config(["capture=x", "out=x", f"motion.sharing={value}"]))


@pytest.mark.parametrize("preset", ["paper", "upstream"])
def test_published_presets_share_nothing(preset):
    motion = check(compose_config(["capture=x", "out=x", f"experiment={preset}"])).motion
    assert sharing_width(motion, 0.0) == sharing_width(motion, 1.0) == 0


def test_corrections_near_pi_are_shared_like_any_other():
    # neighbours whose estimates are one rotation written with opposite signs: corrections live in the joint's own
    # frame, so the gradient of one is a gradient of the other
    poses = np.zeros((2, 22, 3), np.float32)
    poses[0, 0, 1], poses[1, 0, 1] = np.pi, -np.pi
    table = MotionTable(Motion(poses, np.zeros((2, 3), np.float32), 15.0), 22)
    optimizer = RowAdam(table.parameters(), lr=0.01)
    for _ in range(10):
        table.zero_grad()
        table([0]).rotations[0, 0, 2, 1].backward()  # turn the first frame's root
        table.trans_correction.grad = torch.zeros(2, 3)
        optimizer.step(*shared_frames(torch.tensor([0.0, 1 / 15]), torch.tensor([0]), 0.4))
    rotations = table().rotations.detach()
    assert torch.allclose(rotations[0], rotations[1], atol=1e-3)
    assert not torch.allclose(rotations[0, 0], table.initial_rotations[0, 0], atol=0.05)


def test_scaling_a_gradient_leaves_the_values():
    x = torch.tensor([1e-20, 1.0, 1e20], requires_grad=True)
    y = scale_gradient(x, 7.0)
    assert torch.equal(y, x)
    y.sum().backward()
    assert x.grad.tolist() == [7, 7, 7]


def test_a_motion_terms_pull_on_a_shown_frame_does_not_hang_on_how_many_frames_there_are(tmp_path):
    pulls = []
    for count in (3, 6):
        capture = write_tiny_capture(tmp_path / f"c{count}", frames=(0, 8, 16, 40, 60, 99)[:count])
        overrides = [f"capture={capture}", "out=x", *SMALL, "losses={l1:1,motion_prior:1}"]
        trainer = Trainer(check(compose_config(overrides)), tmp_path / f"r{count}")
        correction = trainer.scene.motion.rotation_correction
        with torch.no_grad():
            correction[:count] = 0.1
        state = trainer.poses.state(shown=2, mended=[])
        picture, mask = torch.zeros(1, 3, 1, 1), torch.zeros(1, 1, 1)
        inputs = LossInputs(render=picture, target=picture, alpha=mask, mask=mask, motion=state)
        trainer.losses.losses["motion_prior"](inputs).backward()
        pulls.append(trainer.poses.leaves[correction].grad[0])
    assert torch.allclose(*pulls, rtol=1e-5)
    assert pulls[0].abs().min() > 0


def test_training_moves_the_frames_between_those_shown(tmp_path):
    capture = write_tiny_capture(tmp_path / "capture")
    base = [f"capture={capture}", *SMALL, "stage1.steps=1", "stage1.batch=1", "stage2.steps=0", "motion.guard=false"]
    base.append("motion.start=0")
    moved = []
    for width in (0, 0.8):
        out = tmp_path / f"run{width}"
        trainer = train(compose_config([*base, f"out={out}", f"motion.sharing={width}"]), out)
        moved.append((trainer.scene.motion.rotation_correction != 0).any(-1).any(-1))
    assert moved[0].sum() == 1
    assert moved[1].sum() == 3  # six successive frames: the shown one and, an eighth of their time away, its neighbours
    assert not moved[1][trainer.scene.frames[-1] + 1 :].any()  # held-out frames never move


def test_the_motion_of_some_frames_has_their_expressions():
    expression = np.arange(10, dtype=np.float32).reshape(5, 2)
    zero = np.zeros((5, 24, 3), np.float32), np.zeros((5, 3), np.float32)
    table = MotionTable(Motion(*zero, 30.0, np.zeros(10, np.float32), "e", expression=expression), 24)
    np.testing.assert_array_equal(table.motion(rows=[3, 1]).expression, expression[[3, 1]])
