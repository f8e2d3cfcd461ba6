"""Which points the training views see, and what colour they see there, told by the rasterizer's own weights.

A pixel is the sum of the Gaussians' colours times their blending weights. So the gradient of `sum(pixel * image)` with
respect to a Gaussian's colour is the sum of its weights times the image: the image as that Gaussian saw it.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from .trainer import Trainer


def gathered(trainer: Trainer, rows: list[int], scale: float, colors: bool = True):
    """For each training view of `rows` at an image scale: (N, 3) sum over pixels of blending weight times premultiplied
    footage (None without `colors`), and (N,) sum of blending weight times mask, in pixels. The avatar is the static one
    in its present poses; the order is that of `rows`.
    """
    avatar, data = trainer.avatar, trainer.footage_at(scale)
    black = torch.zeros(3, device=trainer.device)
    with torch.no_grad():
        attributes = avatar.attributes()
        rotations, trans = trainer.motion(trainer.frames)
    for row in rows:
        at = trainer.frames.index(data.views[row].frame)
        with torch.no_grad():
            expression = trainer.motion.expression([data.views[row].frame])
            (gaussians,) = avatar.pose(attributes, rotations[at : at + 1], trans[at : at + 1], expression)
        color, alpha = data.batch([row], black.cpu(), trainer.device)
        images = [alpha[0, ..., None].expand(-1, -1, 3)] + ([color[0].permute(1, 2, 0)] if colors else [])
        sums = []
        for image in images:
            paint = gaussians.colors.detach().clone().requires_grad_()
            rendering = trainer.rasterize(dataclasses.replace(gaussians, colors=paint), data.cameras[row], black)
            sums += torch.autograd.grad((rendering.color * image).sum(), paint)
        yield sums[1] if colors else None, sums[0][:, 0]


def blending_weights(trainer: Trainer, scale: float) -> Tensor:
    """(N,) pixels of the person that each point of the avatar made, over all training views."""
    total = torch.zeros(len(trainer.avatar.surface), device=trainer.device)
    for _, weight in gathered(trainer, list(range(len(trainer.views))), scale, colors=False):
        total += weight
    return total
