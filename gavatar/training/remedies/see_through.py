"""How much shows through an avatar from directions that nobody filmed, and how large its Gaussians must be to close."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.geometry.spacing import evenly_spaced

from ...attributes import Attributes
from ...avatar.trainable import Pose
from ..scene import Scene
from .prior import static_look

FLOORS = (0.2, 0.25, 0.3, 0.35, 0.4, 0.45)  # of the spacing; the first cost no score, from 0.5 on pictures blur
CLOSED = 0.003  # share of the body's inside through which the background may show
HOLE = 0.9  # opacity below which it shows
VIEWS, FINER = 16, 2  # pictures that are drawn for each floor, at this many times the trained size
AMPLE = 0.5  # of the spacing: an even lattice of such Gaussians is closed, and the gap between two legs is not
REACH = 1.2  # standard deviations from the outermost centres at which such a surface is about half opaque


@torch.no_grad()
def see_through(scene: Scene, image: float, floors: Sequence[float]) -> list[float]:
    """For each floor the share of the body's inside where the background shows, were no Gaussian smaller than that
    many times its spacing.

    Trained cameras that see a place at a slant only hide its gaps; so the person is turned by all angles before some of
    the views, in the poses that these show. What is inside is told by the avatar with Gaussians that close (`AMPLE`),
    less a margin of what they reach further. image: scale of the images trained on, which are drawn at `FINER` times
    it.
    """
    out, spacing = static_look(scene.avatar), scene.avatar.spacing
    unit = spacing if out.scales.dim() == 2 else spacing[:, None]
    rows = evenly_spaced(len(scene.views), VIEWS)
    holes, inside = np.zeros(len(floors)), 0
    for i, row in enumerate(rows):
        frame = scene.views[row].frame
        pose = turned(scene.motion([frame]), 2 * math.pi * (i + 0.5) / len(rows))
        camera = scene.footage.capture.camera(scene.views[row]).scaled(image)
        depth = float(camera.T_camera_world[2, :3] @ pose.trans[0].cpu().numpy() + camera.T_camera_world[2, 3])
        pixel = 2 * depth / (camera.fx + camera.fy)
        if pixel <= 0:
            continue

        def alpha(floor: float) -> np.ndarray:
            larger: Attributes = dataclasses.replace(out, scales=torch.maximum(out.scales, floor * unit))
            return scene.draw(larger, pose, [camera.scaled(FINER)], pixel=pixel)[1][0].cpu().numpy()  # noqa: B023

        margin = math.ceil(REACH * AMPLE * float(spacing.median()) / (pixel / FINER)) + 1
        solid = cv2.erode((alpha(AMPLE) >= HOLE).astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8)) > 0
        inside += int(solid.sum())
        holes += [int((alpha(floor)[solid] < HOLE).sum()) for floor in floors]
    return (holes / max(inside, 1)).tolist()


def turned(pose: Pose, angle: float) -> Pose:
    """Poses turned on the spot by an angle about the vertical, radians."""
    c, s = math.cos(angle), math.sin(angle)
    turn: Tensor = pose.rotations.new_tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return dataclasses.replace(pose, rotations=torch.cat([turn @ pose.rotations[:, :1], pose.rotations[:, 1:]], 1))


def least_floor(shares: Sequence[float], floors: Sequence[float] = FLOORS) -> float:
    """The smallest floor that leaves no more than `CLOSED` to show through; the largest where none does."""
    return next((floor for floor, share in zip(floors, shares, strict=True) if share <= CLOSED), floors[-1])
