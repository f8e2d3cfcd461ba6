"""Points of a shaped body given by face and barycentric weights: where they are and what carries them."""

from __future__ import annotations

from typing import Any

import numpy as np

from gavatar_runtime.values.body import BodyData

MAX_WEIGHTS = 8


def areas(body: BodyData, betas: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Corners (F, 3, 3) of the faces of a shaped body in its canonical pose, metres, and their areas (F,), float64."""
    vertices, _ = body.posed(body.canonical_pose(), betas)
    corners = np.asarray(vertices, np.float64)[body.faces]
    return corners, 0.5 * np.linalg.norm(_face_normals(corners), axis=-1)


def on_body(body: BodyData, betas: np.ndarray | None, face: np.ndarray, barycentric: np.ndarray) -> dict[str, Any]:
    """All of a `Surface` that follows from face (N,) and barycentric weights (N, 3) of its points: `uv`, `spacing` and
    `rank` are left to say. betas: (B,) shape coefficients, or None for the mean shape."""
    corners, _ = areas(body, betas)
    joint_index, joint_weight, truncation = _blend_weights(body, face, barycentric)
    _, joints = body.shaped(betas)
    return {
        "face": face.astype(np.int32),
        "barycentric": barycentric.astype(np.float32),
        "points": interpolate(corners, face, barycentric).astype(np.float32),
        "normals": normals_of(body, corners, face, barycentric).astype(np.float32),
        "joint_index": joint_index,
        "joint_weight": joint_weight,
        "joints": np.asarray(joints, np.float64),
        "parents": np.asarray(body.parents, np.int32),
        "A_canonical": np.asarray(body.skinning(body.canonical_pose(), betas), np.float64),
        "weight_truncation": truncation,
    }


def atlas_uv(body: BodyData, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """(N, 2) float32 places of points in the body's atlas as (u, 1 - v), v down (`Surface.uv`)."""
    uv = interpolate(np.asarray(body.uv, np.float64)[body.uv_faces], face, np.asarray(barycentric, np.float64))
    return np.stack([uv[:, 0], 1 - uv[:, 1]], -1).astype(np.float32)


def interpolate(corner_values: np.ndarray, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """Values of the corners (F, 3, C) at points given by face (N,) and weights (N, 3) -> (N, C)."""
    return sum(barycentric[:, i, None] * corner_values[face, i] for i in range(3))


def normals_of(body: BodyData, corners: np.ndarray, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """(N, 3) float64 unit normals interpolated from those of vertices, which are the area-weighted mean of their faces'
    normals; where the interpolated one vanishes, the face's own. corners: (F, 3, 3) of the faces."""
    faces, face_normals, num_vertices = body.faces, _face_normals(corners), len(body.v_template)
    at_vertex: np.ndarray = np.stack(
        [np.bincount(faces.reshape(-1), np.repeat(face_normals[:, axis], 3), num_vertices) for axis in range(3)], -1
    )
    at_vertex /= np.maximum(np.linalg.norm(at_vertex, axis=-1, keepdims=True), 1e-300)
    normals = interpolate(at_vertex[faces], face, barycentric)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(length > 1e-6, normals, face_normals[face])
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _blend_weights(body: BodyData, face: np.ndarray, barycentric: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Barycentric blend of the vertices' skinning weights: (N, K) int32, (N, K) float32, largest sum left out."""
    corner_weights = np.asarray(body.lbs_weights, np.float64)[body.faces]
    used = np.any(corner_weights != 0, 1)
    # a face touches few joints: blend those alone
    candidates = np.argsort(~used, 1, kind="stable")[:, : max(1, int(used.sum(1).max()))]
    weights = interpolate(np.take_along_axis(corner_weights, candidates[:, None], 2), face, barycentric)
    order = np.argsort(-weights, 1, kind="stable")
    count = min(MAX_WEIGHTS, max(1, int(np.count_nonzero(weights, axis=1).max())))
    weights = np.take_along_axis(weights, order, 1)
    kept, lost = np.sum(weights[:, :count], 1), np.sum(weights[:, count:], 1)
    weights = (weights[:, :count] / kept[:, None]).astype(np.float32)
    index = np.where(weights > 0, np.take_along_axis(candidates[face], order[:, :count], 1), 0).astype(np.int32)
    return index, weights, float(np.max(lost))


def _face_normals(corners: np.ndarray) -> np.ndarray:
    """(F, 3) normals of faces, twice their area long."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
