"""How much of the training views each point makes up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ...attributes import Attributes
from ...images.pixel_weights import pixel_weights

if TYPE_CHECKING:
    from ..trainer import Trainer


def view_weights(trainer: Trainer, row: int, scale: float, attributes: Attributes | None = None) -> Tensor:
    """(N,) pixels of the person in training view `row`, at an image scale, that each point of the avatar makes up.

    The avatar is the static one, in the poses that it has now. attributes: as decoded before, if they were.
    """
    avatar, data = trainer.avatar, trainer.footage_at(scale)
    frame = data.views[row].frame
    with torch.no_grad():
        rotations, trans = trainer.motion([frame])
        posed = avatar.pose(attributes or avatar.attributes(), rotations, trans, trainer.motion.expression([frame]))[0]
    _, mask = data.batch([row], torch.zeros(3), trainer.device)
    return pixel_weights(trainer.rasterize, posed, data.cameras[row], mask[0])


def blending_weights(trainer: Trainer, scale: float) -> Tensor:
    """(N,) pixels of the person that each point of the avatar makes up, over all training views."""
    with torch.no_grad():
        attributes = trainer.avatar.attributes()
    return sum(view_weights(trainer, row, scale, attributes) for row in range(len(trainer.views)))
