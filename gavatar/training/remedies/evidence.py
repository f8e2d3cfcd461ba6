"""How much of the training views each point makes up."""

from __future__ import annotations

import torch
from torch import Tensor

from ...attributes import Attributes
from ...images.pixel_weights import pixel_weights
from ..scene import Scene


def view_weights(scene: Scene, row: int, scale: float, attributes: Attributes | None = None) -> Tensor:
    """(N,) pixels of the person in the view `row`, at an image scale, that each point of the avatar makes up.

    The avatar is the static one, in the poses that it has now. attributes: as decoded before, if they were.
    """
    footage = scene.footage.at(scale)
    with torch.no_grad():
        (gaussians,) = scene.gaussians(attributes or scene.avatar.attributes(), scene.motion(scene.frames_of([row])))
    _, mask = footage.batch([row], torch.zeros(3), scene.device)
    return pixel_weights(scene.rasterize, gaussians, footage.cameras[row], mask[0])


def blending_weights(scene: Scene, scale: float) -> Tensor:
    """(N,) pixels of the person that each point of the avatar makes up, over all views."""
    with torch.no_grad():
        attributes = scene.avatar.attributes()
    weights = (view_weights(scene, row, scale, attributes) for row in range(len(scene.views)))
    return sum(weights, torch.zeros(()))
