"""Images over the UV atlas of what a pose does to the body's surface: what pose encoders look at."""

from __future__ import annotations

import numpy as np

from ..geometry.kinematics import skin
from ..values.surface import Atlas, _check_poses


def positional_map(surface: Atlas, poses: np.ndarray) -> np.ndarray:
    """Positions of the posed surface as an image over the UV atlas (paper, section 3.2), root-relative.

    poses: (..., J, 3) axis-angle, radians; leading axes are a batch. Returns (..., R, R, 3) float32, metres, in the
    frame of the root joint: its rotation is taken as zero and its place is the origin, so that the map depends neither
    on where the person stands nor on where they face. Invalid texels are zero. Raises ValueError when the joints are
    not J.
    """
    return _over_atlas(surface, surface.points, root_relative_transforms(surface, poses))


def root_relative_transforms(surface: Atlas, poses: np.ndarray) -> np.ndarray:
    """(..., J, 4, 4) float32 canonical-to-posed transforms in the frame of the root joint (see `positional_map`)."""
    poses = np.array(poses, np.float32)
    _check_poses(poses, surface.num_joints)
    poses[..., surface.root, :] = 0
    A = surface.skin_transforms(poses)
    A[..., :3, 3] -= surface.joints[surface.root].astype(np.float32)
    return A


def normal_map(surface: Atlas, poses: np.ndarray) -> np.ndarray:
    """Unit normals of the posed surface as an image over the UV atlas, in the world.

    poses: (..., J, 3) axis-angle, radians, the root's included; leading axes are a batch. Returns (..., R, R, 3)
    float32. Invalid texels are zero, as is a normal that skinning cancels. Raises ValueError when the joints are not J.
    """
    maps = _over_atlas(surface, surface.normals, turning_transforms(surface, poses))
    return maps / np.maximum(np.linalg.norm(maps, axis=-1, keepdims=True), 1e-6)


def turning_transforms(surface: Atlas, poses: np.ndarray) -> np.ndarray:
    """(..., J, 4, 4) float32 canonical-to-posed transforms of directions, in the world (see `normal_map`)."""
    A = surface.skin_transforms(np.asarray(poses, np.float32))
    A[..., :3, 3] = 0
    return A


def _over_atlas(surface: Atlas, vectors: np.ndarray, A: np.ndarray) -> np.ndarray:
    """(..., R, R, 3) vectors (N, 3) of the surface's points, each skinned by transforms (..., J, 4, 4)."""
    R = surface.resolution
    maps = np.zeros((*A.shape[:-3], R * R, 3), np.float32)
    for index in np.ndindex(*A.shape[:-3]):
        maps[index][surface.texel] = skin(vectors, surface.joint_index, surface.joint_weight, A[index])
    return maps.reshape(*A.shape[:-3], R, R, 3)
