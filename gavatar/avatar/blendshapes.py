"""What a body's linear blendshapes do at the points of its sampled surface, in the canonical pose."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.avatar.expression import Expression
from gavatar_runtime.avatar.pose_blendshapes import PoseBlendshapes, canonical_rotations
from gavatar_runtime.geometry.kinematics import moved_rest
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Surface

from .on_body import interpolate


def at_points(body: BodyData, surface: Surface, directions: np.ndarray) -> np.ndarray:
    """(N, 3, C) directions at the surface's points, in the rest pose, from those of the vertices (V, 3, C)."""
    flat = directions.reshape(len(directions), -1)[body.faces]
    values = interpolate(flat, surface.face, surface.barycentric.astype(directions.dtype))
    return values.reshape(-1, *directions.shape[1:])


def pose_blendshapes_of(body: BodyData, surface: Surface) -> PoseBlendshapes:
    """The pose blendshapes of a body that has some, at the points of its surface."""
    if body.posedirs is None:
        raise ValueError(f"body '{body.name}' has no pose blendshapes")
    return PoseBlendshapes.of(body.posedirs, body.canonical_pose(), body.faces[surface.face], surface.barycentric)


def expression_of(body: BodyData, surface: Surface) -> Expression | None:
    """The body's expressions at the points of its surface, None of a body without any.

    Exact to the first order and, since the canonical transforms of joints that move are linear in where they rest,
    beyond it: skinning the moved points by `Surface.skin_transforms(pose, shift)` is what the body does with its
    vertices wherever canonical skinning is rigid.
    """
    if body.exprdirs is None or body.num_expression == 0:
        return None
    joints = np.einsum("jv,vce->jce", body.J_regressor, body.exprdirs, optimize=True)
    canonical = canonical_rotations(surface) @ at_points(body, surface, body.exprdirs)
    offset = surface.A_canonical[:, :3, 3]
    for e in range(body.num_expression):
        moved = moved_rest(surface.A_canonical, surface.joints + joints[:, :, e], surface.parents)[:, :3, 3] - offset
        if np.any(moved):
            canonical[:, :, e] += np.einsum("nk,nkc->nc", surface.joint_weight, moved[surface.joint_index])
    return Expression.of(canonical, joints)


def shape_of(body: BodyData, surface: Surface, count: int) -> tuple[np.ndarray, np.ndarray]:
    """What the first `count` betas do to the surface's points, (N, 3, count), and to the rest joints, (J, 3, count),
    metres a unit coefficient. Both are linear in the betas, since the canonical pose is fixed: one difference each."""
    corners, places = [], []
    for betas in np.eye(count + 1, count, -1):  # zero, then each coefficient
        vertices, _ = body.posed(body.canonical_pose(), betas)
        corners.append(np.asarray(vertices, np.float64)[body.faces])
        places.append(body.shaped(betas)[1])
    points = [interpolate(corner - corners[0], surface.face, surface.barycentric) for corner in corners[1:]]
    return np.stack(points, -1), np.stack([place - places[0] for place in places[1:]], -1)
