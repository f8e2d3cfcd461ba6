"""Inputs for the tests of losses: at a perfect match, away from it, motions, and stand-ins for LPIPS's weights."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import torch

from gavatar.body.torch_rotations import matrix_from_axis_angle
from gavatar.images.lpips import BACKBONES
from gavatar.losses import LossInputs, MotionState


def write_lpips_weights(folder: Path) -> dict[str, tuple[Path, Path]]:
    """net -> (backbone, linear): files of the right layout with random numbers; the real ones cannot be shipped."""
    files = {}
    generator = torch.Generator().manual_seed(1)
    for net, description in BACKBONES.items():
        backbone, linear, channels, number = {}, {}, 3, 0
        for i, (pooled, convolutions) in enumerate(description.slices):
            number += pooled
            for width, kernel, _, _ in convolutions:
                weight = torch.randn(width, channels, kernel, kernel, generator=generator)
                backbone[f"features.{number}.weight"] = weight / (kernel * math.sqrt(channels))
                backbone[f"features.{number}.bias"] = torch.randn(width, generator=generator) * 0.1
                channels, number = width, number + 2
            linear[f"lin{i}.model.1.weight"] = torch.rand(1, channels, 1, 1, generator=generator)
        files[net] = (folder / description.checkpoint, folder / f"{net}.pth")
        torch.save(backbone, files[net][0])
        torch.save(linear, files[net][1])
    return files


def motion(axis_angle, trans=None, fps=30.0, times=None, initial=None) -> MotionState:
    """A MotionState from (T, J, 3) axis-angle."""
    axis_angle = torch.as_tensor(axis_angle)
    rotations = matrix_from_axis_angle(axis_angle)
    trans = torch.zeros(len(axis_angle), 3, dtype=rotations.dtype) if trans is None else torch.as_tensor(trans)
    times = torch.arange(len(axis_angle), dtype=rotations.dtype) / fps if times is None else torch.as_tensor(times)
    return MotionState(
        rotations=rotations,
        rotations_initial=rotations.detach().clone() if initial is None else matrix_from_axis_angle(initial),
        trans=trans,
        trans_initial=trans.detach().clone(),
        frame_times=times.to(rotations.dtype),
    )


FIELDS = ("render", "alpha", "features", "pose_features", "pose_detail", "to_neighbours", "offsets", "scales")


def perfect(batch=1, height=40, width=33, dtype=torch.float32) -> LossInputs:
    """Inputs at which every loss is at its minimum, as leaves that ask for gradient."""
    generator = torch.Generator().manual_seed(0)
    target = torch.rand(batch, 3, height, width, generator=generator, dtype=dtype)
    mask = torch.rand(batch, height, width, generator=generator, dtype=dtype)
    leaf = {
        "render": target.clone(), "alpha": mask.clone(), "features": torch.zeros(1, 4, 8, 8, dtype=dtype),
        "pose_features": torch.zeros(batch, 4, 8, 8, dtype=dtype), "offsets": torch.zeros(batch, 9, 3, dtype=dtype),
        "scales": torch.zeros(1, 9, dtype=dtype), "pose_detail": torch.zeros(batch, 9, 3, dtype=dtype),
        "to_neighbours": torch.zeros(1, 9, 7, dtype=dtype),
    }  # fmt: skip
    still = motion(torch.zeros(4, 5, 3, dtype=dtype))
    state = dataclasses.replace(still, rotations=still.rotations.requires_grad_(), trans=still.trans.requires_grad_())
    return LossInputs(
        target=target, mask=mask, motion=state, progress=0.5, **{k: v.requires_grad_() for k, v in leaf.items()}
    )


def leaves(inputs: LossInputs) -> list[torch.Tensor]:
    return [getattr(inputs, f) for f in FIELDS] + [inputs.motion.rotations, inputs.motion.trans]


def disturbed(inputs: LossInputs, amount: float = 0.2, seed: int = 3) -> LossInputs:
    """The same inputs away from the minimum; images stay in [0, 1], scales positive, rotations are rotations."""
    g = torch.Generator().manual_seed(seed)

    def noise(x):
        return amount * torch.randn(x.shape, generator=g, dtype=x.dtype)

    changed = {f: (getattr(inputs, f) + noise(getattr(inputs, f))).detach() for f in FIELDS}
    changed["render"], changed["alpha"] = changed["render"].clamp(0, 1), changed["alpha"].clamp(0, 1)
    changed["scales"] = changed["scales"].abs()
    m = inputs.motion
    turned = m.rotations.detach() @ matrix_from_axis_angle(noise(m.rotations[..., 0].detach()))
    moved = (m.trans + noise(m.trans)).detach()
    m = dataclasses.replace(m, rotations=turned.requires_grad_(), trans=moved.requires_grad_())
    return dataclasses.replace(inputs, motion=m, **{k: v.requires_grad_() for k, v in changed.items()})
