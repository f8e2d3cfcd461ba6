"""Whether the person has another shape than was estimated, told by a trial on views that take no part in it."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from ..scene import WHITE, Scene

COEFFICIENTS = 10
STEPS, BATCH = 24, 4
RATE, SHIFT_RATE = 0.1, 0.005  # of the coefficients, in standard deviations, and of the whole body, in metres, a step
JUDGES = 32  # views that judge, at most
LEAST_VIEWS = 8


@dataclasses.dataclass(frozen=True)
class ShapeTrial:
    """gain_db: mean gain in PSNR of the judging views. change: (n,) of the coefficients that gave it."""

    gain_db: float
    change: np.ndarray


def shape_trial(scene: Scene, scale: float) -> ShapeTrial | None:
    """What the avatar as it is now gains by another shape and place of the whole body, fitted to every other view at an
    image scale and judged on those between; the scene stays as it is. None for a body without shape coefficients, and
    where the views are too few."""
    count, views = min(COEFFICIENTS, scene.built.body.data.num_betas), len(scene.views)
    if count == 0 or views < LEAST_VIEWS:
        return None
    avatar, training = scene.avatar, scene.avatar.training
    avatar.eval()
    change, shift = torch.zeros(count, device=scene.device), torch.zeros(3, device=scene.device)
    judges = list(range(1, views, 2))[:: max(1, -(-views // (2 * JUDGES)))]
    before = _errors(scene, scale, judges, change, shift)
    change.requires_grad_(), shift.requires_grad_()
    optimizer = torch.optim.Adam([{"params": [change], "lr": RATE}, {"params": [shift], "lr": SHIFT_RATE}])
    random, learners = np.random.default_rng(0), np.arange(0, views, 2)
    for _ in range(STEPS):
        rows = [int(row) for row in random.permutation(learners)[:BATCH]]
        loss = _difference(scene, scale, rows, change, shift).mean()
        change.grad, shift.grad = torch.autograd.grad(loss, [change, shift])
        optimizer.step()
    change, shift = change.detach(), shift.detach()
    after = _errors(scene, scale, judges, change, shift)
    avatar.train(training)
    gain = 10 * np.log10(np.maximum(before, 1e-10) / np.maximum(after, 1e-10))
    return ShapeTrial(round(float(gain.mean()), 3), change.double().cpu().numpy())


def _difference(scene: Scene, scale: float, rows: list[int], change: Tensor, shift: Tensor) -> Tensor:
    """(B,) mean squared errors on white of the views in `rows`, the body's shape and place changed."""
    with torch.no_grad():
        attributes, pose = scene.avatar.attributes(), scene.motion(scene.frames_of(rows))
    pose = dataclasses.replace(pose, trans=pose.trans + shift)
    footage = scene.footage.at(scale)
    target, _ = footage.batch(rows, WHITE, scene.device)
    drawn = [
        scene.rasterize(gaussians, footage.cameras[row], WHITE.to(scene.device)).color
        for gaussians, row in zip(scene.avatar.pose(attributes, pose, change), rows, strict=True)
    ]
    return (torch.stack(drawn).permute(0, 3, 1, 2) - target).square().flatten(1).mean(1)


@torch.no_grad()
def _errors(scene: Scene, scale: float, rows: list[int], change: Tensor, shift: Tensor) -> np.ndarray:
    return np.array([float(_difference(scene, scale, [row], change, shift)) for row in rows])
