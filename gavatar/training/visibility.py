"""Which points the training views see, told by the rasterizer's own weights."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from .trainer import Trainer


def view_weights(trainer: Trainer, row: int, scale: float) -> Tensor:
    """(N,) pixels of the person in training view `row`, at an image scale, that each point of the avatar makes up.

    A pixel is the sum of the Gaussians' colours times their blending weights. So the gradient of `sum(pixel * mask)`
    with respect to a Gaussian's colour is the sum of its weights inside the mask. The avatar is the static one, in the
    poses that it has now.
    """
    avatar, data = trainer.avatar, trainer.footage_at(scale)
    black, frame = torch.zeros(3), data.views[row].frame
    with torch.no_grad():
        rotations, trans = trainer.motion([frame])
        posed = avatar.pose(avatar.attributes(), rotations, trans, trainer.motion.expression([frame]))[0]
    _, mask = data.batch([row], black, trainer.device)
    paint = posed.colors.detach().clone().requires_grad_()
    drawn = trainer.rasterize(dataclasses.replace(posed, colors=paint), data.cameras[row], black.to(trainer.device))
    (gradient,) = torch.autograd.grad((drawn.color[..., 0] * mask[0]).sum(), paint)
    return gradient[:, 0]


def blending_weights(trainer: Trainer, scale: float) -> Tensor:
    """(N,) pixels of the person that each point of the avatar makes up, over all training views."""
    return sum(view_weights(trainer, row, scale) for row in range(len(trainer.views)))
