"""How new the pose of each training view is: a pose that recurs counts once, however many frames show it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.values.body import SMPL_BODY_JOINTS

from .scene import Scene

ALIKE = 0.15  # radians, root mean square over the joints: poses this far apart are hardly the same one
TURNED = 0.35  # radians: the same of a person turned before the camera
LEAST, MOST = 0.25, 4.0  # how often a view is drawn at least and at most, of what it would be if all were alike


def view_poses(scene: Scene) -> Tensor:
    """(V, D) a place for the pose of each view, as it was estimated, turned as its camera sees it: the distance of two
    is 1 where poses are as far apart as `ALIKE` and `TURNED` say. Rotations far apart are nearer than their angle."""
    cameras = [scene.footage.capture.camera(view) for view in scene.views]
    rotations = scene.motion.estimated(scene.frames_of(range(len(scene.views)))).rotations.double().cpu()
    turns = torch.from_numpy(np.stack([camera.T_camera_world[:3, :3] for camera in cameras])).double() @ rotations[:, 0]
    joints = rotations[:, 1:SMPL_BODY_JOINTS].flatten(1) / (2 * (SMPL_BODY_JOINTS - 1)) ** 0.5
    return torch.cat([joints / ALIKE, turns.flatten(1) / (2**0.5 * TURNED)], 1)


def newness(places: Tensor) -> Tensor:
    """(V,) one divided by the number of views that are like each one, itself among them: 1 for a pose that is shown
    once. places: (V, D), like where they are nearer than 1 (a Gaussian)."""
    return 1 / torch.exp(-0.5 * torch.cdist(places, places).square()).sum(1)


def draw_shares(new: Tensor) -> np.ndarray:
    """(V,) how many times an epoch each view is drawn, 1 in the mean: by its newness, between a quarter and four times
    the mean of them."""
    shares = (new / new.mean()).clamp(LEAST, MOST)
    return (shares / shares.mean()).numpy()
