"""Points of a body's surface: any number, evenly apart or denser where a density says, in progressive order."""

from __future__ import annotations

import hashlib
import numbers
import os
from pathlib import Path
from typing import Any

import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.ordering import morton_codes
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Surface

from . import blue_noise
from .blue_noise import CANDIDATES, progressive_order
from .on_body import areas, atlas_uv, interpolate, normals_of, on_body
from .surface_cache import cached

MOST = 1_000_000
_SPARE = 64  # candidates beyond those for each point: a handful of points is chosen among more than a few
HEAD, HANDS = ("head",), ("left_wrist", "right_wrist")  # the joints that these parts of a body begin with


def sample_points(
    body: BodyData,
    betas: np.ndarray | None,
    count: int,
    density: np.ndarray | None = None,
    *,
    cache_dir: str | os.PathLike[str] | None = None,
) -> Surface:
    """`count` points of a shaped body in its canonical pose, of which each prefix is as evenly spread as all are.

    betas: (B,) shape coefficients, or None for the mean shape. count: 1 to 1,000,000. density: (V,) points an area at
    the body's vertices, up to a common factor, 0 or more; None for the same everywhere. cache_dir: see
    `surface_cache.cached`. The same arguments give the same points.

    They lie anywhere on the faces that have an area, at random but apart from one another (blue noise, `blue_noise`),
    and are stored along a Morton curve. Where on a face does not depend on `betas`: they are spread over the mean
    shape, so that a person whose shape is refined keeps their points; the spacing is that of the shape asked for.

    Raises UserError for a count out of range, betas that are not finite and a density that is not one.
    """
    check_count(count, "number of points")
    if betas is not None and not np.all(np.isfinite(betas)):
        raise UserError("betas hold NaN or infinity: give finite shape coefficients, or none for the mean shape")
    vertices = len(body.v_template)
    density = np.ones(vertices) if density is None else np.asarray(density, np.float64)
    if density.shape != (vertices,) or not (np.all(np.isfinite(density)) and np.all(density >= 0) and np.any(density)):
        raise UserError(f"density of points must be {vertices} finite numbers, 0 or more and not all 0")
    code = hashlib.sha256(Path(blue_noise.__file__).read_bytes() + density.tobytes()).hexdigest()
    name, key = f"points-{int(count)}", f"{int(count)} {code}"
    mean = cached(name, body, None, key, Path(__file__), lambda: _sample(body, int(count), density), cache_dir)
    return mean if betas is None else _reshaped(mean, body, betas)


def check_count(value: Any, field: str) -> None:
    """UserError naming `field` unless `value` is a number of points that a surface may have."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not whole or not 1 <= value <= MOST:
        raise UserError(f"{field} {value!r} is not possible: choose a whole number from 1 to {MOST:,}")


def share_of(body: BodyData, joints: tuple[str, ...]) -> np.ndarray:
    """(V,) which share of the skinning weights of each vertex the joints of these names and all that hang from them
    have, 0 to 1; a body without joints of these names has none."""
    inside = np.array([name in joints for name in body.joint_names])
    for joint, parent in enumerate(body.parents):  # parents stand before their children
        inside[joint] |= parent >= 0 and inside[parent]
    return np.asarray(body.lbs_weights, np.float64)[:, inside].sum(1)


def _sample(body: BodyData, count: int, density: np.ndarray) -> Surface:
    """The points on the mean shape."""
    corners, area = areas(body, None)
    of_faces = np.where(np.isfinite(area), area, 0) * density[body.faces].mean(1)
    total = float(of_faces.sum())
    if not total > 0:
        raise UserError(f"body '{body.name}': no face with an area has a density: there is no place for a point")
    rng = np.random.default_rng(0)
    offered = CANDIDATES * count + _SPARE
    face = rng.choice(len(of_faces), offered, p=of_faces / total)
    barycentric = _within_triangles(rng.random((offered, 2)))
    at = interpolate(density[body.faces][..., None], face, barycentric)[:, 0]
    spacing = np.sqrt(total / count / np.maximum(at, 1e-6 * density.max()))
    places = interpolate(corners, face, barycentric)
    order = progressive_order(places, normals_of(body, corners, face, barycentric), spacing, count)
    stored = np.argsort(morton_codes(places[order]), kind="stable")
    rows = order[stored]
    return Surface(
        **on_body(body, None, face[rows], barycentric[rows]),
        uv=atlas_uv(body, face[rows], barycentric[rows]),
        spacing=spacing[rows].astype(np.float32),
        rank=stored.astype(np.int32),
    )


def _reshaped(mean: Surface, body: BodyData, betas: np.ndarray) -> Surface:
    """The points of the mean shape on another one."""
    area, shaped = areas(body, None)[1][mean.face], areas(body, betas)[1][mean.face]
    stretch = np.sqrt(np.maximum(shaped, 1e-6 * area) / area)
    places = on_body(body, betas, mean.face, mean.barycentric.astype(np.float64))
    return Surface(**places, uv=mean.uv, spacing=mean.spacing * stretch.astype(np.float32), rank=mean.rank)


def _within_triangles(uniform: np.ndarray) -> np.ndarray:
    """(N, 3) barycentric weights spread evenly over a triangle, of numbers (N, 2) spread evenly over [0, 1)."""
    root = np.sqrt(uniform[:, 0])
    return np.stack([1 - root, root * (1 - uniform[:, 1]), root * uniform[:, 1]], -1)
