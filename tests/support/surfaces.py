"""Sampled surfaces of the free body and of a few triangles, and what is known about them by other ways."""

from __future__ import annotations

import functools

import numpy as np

from gavatar.avatar.atlas import sample_atlas
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Atlas

# float32 holds a coordinate of 2 m to 1.2e-7; a few roundings of such coordinates are summed
FLOAT32_METRES = 2e-6
BETAS = np.array([1.0, -0.5, 0.3, 0, 0, 0, 0, 0, 0, 2.0])


@functools.cache
def free_surface(resolution: int, betas: tuple | None = None, order: str = "morton") -> Atlas:
    return sample_atlas(load_free_body(), betas, resolution, order=order)


def patch_body(uv, faces=((0, 1, 2),), vertices=None, uv_faces=None, lbs_weights=None) -> BodyData:
    """A body of three joints in a row whose skin is a few triangles; by default in space they are as in the atlas."""
    uv = np.asarray(uv, np.float32)
    vertices = np.pad(uv, ((0, 0), (0, 1))) if vertices is None else np.asarray(vertices, np.float32)
    if lbs_weights is None:
        lbs_weights = np.tile(np.float32([1, 0, 0]), (len(vertices), 1))
    J = lbs_weights.shape[1]
    return BodyData(
        name="patch",
        v_template=vertices,
        shapedirs=np.zeros((len(vertices), 3, 1), np.float32),
        J_regressor=np.full((J, len(vertices)), 1 / len(vertices), np.float32),
        parents=np.arange(-1, J - 1, dtype=np.int32),
        lbs_weights=lbs_weights,
        faces=np.asarray(faces, np.int32),
        uv=uv,
        uv_faces=np.asarray(faces if uv_faces is None else uv_faces, np.int32),
        joint_names=("pelvis", "left_hip", "right_hip", *(f"joint{j}" for j in range(3, J)))[:J],
    )


def random_poses(count: int, scale: float = 0.5) -> np.ndarray:
    return np.random.default_rng(7).normal(0, scale, (count, load_free_body().num_joints, 3))


def blend_in_float64(surface: Atlas, poses: np.ndarray) -> np.ndarray:
    """(N, 3) linear blend skinning of the canonical points, written out densely with a general matrix inverse."""
    body = load_free_body()
    transforms = body.skinning(poses) @ np.linalg.inv(body.skinning(body.canonical_pose()))
    weights = np.zeros((len(surface), body.num_joints))
    np.add.at(weights, (np.arange(len(surface))[:, None], surface.joint_index), surface.joint_weight)
    homogeneous = np.pad(surface.points.astype(np.float64), ((0, 0), (0, 1)), constant_values=1)
    return np.einsum("nj,jab,nb->na", weights, transforms, homogeneous)[:, :3]


def atlas_place(surface: Atlas, body: BodyData) -> np.ndarray:
    """(N, 2) where face and barycentric weights lie in the atlas, as (x, y) in texels, y down."""
    corners = body.uv.astype(np.float64)[body.uv_faces[surface.face]]
    uv = np.einsum("nc,ncd->nd", surface.barycentric.astype(np.float64), corners)
    return np.stack([uv[:, 0], 1 - uv[:, 1]], -1) * surface.resolution
