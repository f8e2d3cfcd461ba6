"""Which places of the body the training views show, and how squarely."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.decoding.uv_maps import normal_map
from gavatar_runtime.geometry.kinematics import skin
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.surface import Atlas, Surface

FACING = 0.1  # cosine from which on a camera is taken to see a texel; what it sees more aslant is a pixel or two wide


def facing_texels(surface: Atlas, motion: Motion, frames: list[int], cameras: list[Camera]) -> Tensor:
    """(V, R, R) bool: the texels that face the camera in each of V views, a frame of `motion` by a camera each.

    The camera is taken to be far: one direction serves the whole body. Texels behind a limb count as seen."""
    out = np.zeros((len(frames), surface.resolution, surface.resolution), bool)
    for frame in sorted(set(frames)):
        normals = normal_map(surface, motion.poses[frame])
        for row in np.flatnonzero(np.equal(frames, frame)):
            direction = cameras[row].position - (motion.trans[frame] + surface.joints[surface.root])
            direction /= max(np.linalg.norm(direction), 1e-9)
            out[row] = normals @ direction > FACING
    return torch.from_numpy(out)


def squareness(surface: Surface, motion: Motion, frame: int, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(N,) cosine between each point's normal and the view of it, in a frame of `motion`, and (N, 3) unit directions to
    the camera as the points themselves see it, in the canonical pose."""
    A = surface.skin_transforms(np.asarray(motion.poses[frame], np.float64))
    moved = skin(surface.points, surface.joint_index, surface.joint_weight, A) + motion.trans[frame]
    blended = np.einsum("nk,nkij->nij", surface.joint_weight, A[surface.joint_index][..., :3, :3])
    towards = camera.position - moved
    towards = np.einsum("nji,nj->ni", blended, towards)  # back by the transposed, which is the inverse but for scale
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    return (surface.normals * towards).sum(1), towards
