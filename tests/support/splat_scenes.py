"""Scenes for the rasterizer tests: random clouds and a body covered with Gaussians. NumPy float64, seeded."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from places import BODY_FILE

from gavatar_runtime.values.camera import Camera, look_at
from gavatar_runtime.values.gaussians import Gaussians

FIELDS = ("means", "scales", "colors", "opacities", "quaternions")


def simple_camera(width: int, height: int, focal: float | None = None, **changes) -> Camera:
    """A camera at the world's origin looking along +z, principal point in the middle unless `changes` say otherwise."""
    focal = focal or float(max(width, height))
    camera = Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))
    return dataclasses.replace(camera, **changes)


def random_scene(
    seed: int, n: int = 60, *, isotropic: bool = True, opacity: bool = False, scale: float = 0.05
) -> Gaussians:
    """n Gaussians in front of `simple_camera`, 1 to 3 m away, some beyond the image's border.

    scale: their median standard deviation, metres (log-normal with sigma 0.5).
    """
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1, 3, n)
    means = np.stack([rng.uniform(-0.6, 0.6, n) * depth, rng.uniform(-0.6, 0.6, n) * depth, depth], 1)
    scales = scale * np.exp(rng.normal(0, 0.5, n if isotropic else (n, 3)))
    return Gaussians(
        means,
        scales,
        rng.uniform(0, 1, (n, 3)),
        rng.uniform(0.02, 1, n) if opacity else None,
        None if isotropic else rng.normal(size=(n, 4)),
    )


@functools.cache
def body_mesh() -> tuple[np.ndarray, np.ndarray]:
    """vertices (V, 3) metres and faces (F, 3) of the body in its template pose."""
    with np.load(BODY_FILE, allow_pickle=False) as body:
        return body["v_template"].astype(np.float64), body["f"].astype(np.int64)


def body_scene(n: int, seed: int = 0) -> Gaussians:
    """n opaque isotropic Gaussians spread over the body's surface, uniformly by area and coherent in face order.

    The scale is the side of the square that each one owns (about 12 mm at 12,700), +-15 %, as training arrives at.
    Normals are those of the faces.
    """
    rng = np.random.default_rng(seed)
    vertices, faces = body_mesh()
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    area = 0.5 * np.linalg.norm(normals, axis=1)
    stratified = (np.arange(n) + rng.random(n)) / n * area.sum()
    face = np.minimum(np.searchsorted(np.cumsum(area), stratified), len(faces) - 1)
    root, t = np.sqrt(rng.random(n))[:, None], rng.random(n)[:, None]
    means = (1 - root) * a[face] + root * (1 - t) * b[face] + root * t * c[face]
    scales = np.sqrt(area.sum() / n) * np.exp(rng.normal(0, 0.15, n))
    texture = 0.5 + 0.5 * np.sin(means @ np.array([[9, 0, 11], [25, 17, 11], [0, 5, 31.0]]) + [0, 3, 1])
    colors = np.clip(0.75 * texture + 0.25 * rng.random((n, 3)), 0, 1)
    return Gaussians(means, scales, colors, normals=normals[face] / np.maximum(2 * area[face, None], 1e-12))


def body_camera(width: int, height: int, distance: float = 2.6, fill: float = 0.8, yaw: float = 0.4) -> Camera:
    """A camera `distance` metres from the body's middle; the body spans `fill` of the image's height."""
    low, high = body_mesh()[0].min(0), body_mesh()[0].max(0)
    target = (low + high) / 2
    eye = target + distance * np.array([np.sin(yaw), 0, np.cos(yaw)])
    focal = fill * height * distance / (high[1] - low[1])
    return Camera(width, height, focal, focal, width / 2, height / 2, look_at(eye, target))


def select(gaussians: Gaussians, keep) -> Gaussians:
    """The Gaussians of index, slice or mask `keep`, arrays of either kind."""
    return map_fields(gaussians, lambda value: value[keep])


def map_fields(gaussians: Gaussians, function) -> Gaussians:
    """`function` applied to every field that is present; normals, no part of the picture, stay behind."""
    values = {name: getattr(gaussians, name) for name in FIELDS}
    return Gaussians(**{name: None if value is None else function(value) for name, value in values.items()})


def as_numpy(gaussians: Gaussians, dtype=np.float32) -> Gaussians:
    converted = map_fields(gaussians, lambda value: np.asarray(value, dtype))
    normals = None if gaussians.normals is None else np.asarray(gaussians.normals, dtype)
    return dataclasses.replace(converted, normals=normals)


def as_torch(gaussians: Gaussians, dtype=None) -> Gaussians:
    """Torch tensors of `dtype` (float32 unless given) with the same values."""
    import torch

    return map_fields(gaussians, lambda value: torch.as_tensor(np.asarray(value)).to(dtype or torch.float32))
