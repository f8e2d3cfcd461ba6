"""Which texels of the body the training views show."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.decoding.uv_maps import normal_map
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.surface import Atlas

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
