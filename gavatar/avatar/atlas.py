"""From a body's UV atlas to points on its surface: one Gaussian's place for each texel that lies on the body."""

from __future__ import annotations

import numbers
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gavatar_runtime.errors import UserError, did_you_mean
from gavatar_runtime.geometry.ordering import progressive_rank
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.surface import Atlas

from .on_body import areas, on_body
from .surface_cache import cached

# At 64 the free body has 2,850 points, 26 mm apart; at 32 it would have 777, 54 mm apart, and fingers without any. At
# 1024 it has 646,000.
MIN_RESOLUTION, MAX_RESOLUTION = 64, 1024
ORDERS = ("morton", "row")
_PAIRS_AT_ONCE = 1 << 20  # (face, texel) pairs tried in one batch; some 100 MB of temporaries


def sample_atlas(
    body: BodyData,
    betas: np.ndarray | None,
    resolution: int,
    *,
    order: str = "morton",
    cache_dir: str | os.PathLike[str] | None = None,
) -> Atlas:
    """The points of a shaped body in its canonical pose, one for each valid texel (paper, section 3.1).

    betas: (B,) shape coefficients, or None for the mean shape. resolution: side R of the atlas, 64 to 1024 texels.
    order: that points are stored in; `morton` follows a Z curve over the atlas, so that points near in memory are near
    on the body, `row` goes texel by texel. cache_dir: see `surface_cache.cached`.

    Valid is a texel whose centre lies in a UV triangle (where triangles overlap, the lowest face wins), or beside the
    triangles but with the nearest point of one in the texel's own square: that point is then the sample, the lowest
    face winning among equally near ones. So samples reach the rim of every chart and the surface closes across seams.
    Faces without area, in the atlas or in space, carry no texel. A face smaller than a texel may get none.

    Raises UserError for a resolution out of range, an unknown order, betas that are not finite, and an atlas that
    covers no texel.
    """
    check_resolution(resolution, "surface resolution")
    if order not in ORDERS:
        raise UserError(f"surface order '{order}' is unknown: {did_you_mean(str(order), ORDERS)}")
    if betas is not None and not np.all(np.isfinite(betas)):
        raise UserError("betas hold NaN or infinity: give finite shape coefficients, or none for the mean shape")
    name = f"surface-{int(resolution)}"
    key, code = f"{resolution} {order}", Path(__file__)
    made = cached(name, body, betas, key, code, lambda: _sample(body, betas, int(resolution), order), cache_dir)
    return made if isinstance(made, Atlas) else _sample(body, betas, int(resolution), order)


def check_resolution(value: Any, field: str) -> None:
    """UserError naming `field` unless `value` is a side of the atlas that surfaces are sampled at."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not whole or not MIN_RESOLUTION <= value <= MAX_RESOLUTION:
        raise UserError(
            f"{field} {value!r} is not possible: choose a whole number from {MIN_RESOLUTION} to {MAX_RESOLUTION}"
        )


def _sample(body: BodyData, betas: np.ndarray | None, resolution: int, order: str) -> Atlas:
    corners, area = areas(body, betas)
    triangles = _texel_triangles(body, resolution)
    texel_area = 0.5 * np.abs(_cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]))

    usable = _has_area(triangles, texel_area) & _has_area(corners, area)
    texel, face, barycentric = _cover(triangles, usable, resolution)
    if len(texel) == 0:
        raise UserError(
            f"body '{body.name}': its UV atlas covers no texel at resolution {resolution}; check `uv` and `uv_faces`"
        )
    sorting = np.argsort(_morton(texel, resolution) if order == "morton" else texel, kind="stable")
    texel, face, barycentric = texel[sorting], face[sorting], barycentric[sorting]
    centre = np.stack([texel % resolution, texel // resolution], -1) + 0.5
    places = on_body(body, betas, face, barycentric)
    return Atlas(
        **places,
        resolution=resolution,
        texel=texel.astype(np.int32),
        uv=(centre / resolution).astype(np.float32),
        spacing=np.sqrt(area[face] / texel_area[face]).astype(np.float32),
        rank=progressive_rank(places["points"]),
    )


def _texel_triangles(body: BodyData, resolution: int) -> np.ndarray:
    """(F, 3, 2) float64 UV triangles as (x right, y down), in texels from the atlas's top left."""
    uv = np.asarray(body.uv, np.float64)
    return np.stack([uv[:, 0], 1 - uv[:, 1]], -1)[body.uv_faces] * resolution


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _has_area(triangles: np.ndarray, area: np.ndarray) -> np.ndarray:
    """(F,) bool: finite and not a line or a point. The coordinates are float32 in origin, so a height below 1e-6 of the
    longest side is rounding."""
    longest = np.max(np.sum((triangles - np.roll(triangles, 1, 1)) ** 2, -1), 1)
    return np.isfinite(area) & (area > 0.5e-6 * longest)


def _cover(triangles: np.ndarray, usable: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Valid texels in row order (N,), the face of each (N,) and barycentric weights (N, 3) float64."""
    faces = np.flatnonzero(usable)
    none = len(triangles)
    owner = np.full(resolution * resolution, none)
    weights = np.zeros((resolution * resolution, 3))
    for face, texel, centre in _pairs(triangles, faces, resolution, 0.0):
        inside = np.all(_barycentric(triangles[face], centre) >= 0, -1)
        np.minimum.at(owner, texel[inside], face[inside])
    inner = np.flatnonzero(owner < none)
    centres = np.stack([inner % resolution, inner // resolution], -1) + 0.5
    weights[inner] = _barycentric(triangles[owner[inner]], centres)

    found = [(np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros((0, 3)))]
    for face, texel, centre in _pairs(triangles, faces, resolution, 0.5, owner == none):
        nearest, barycentric = _nearest_on_rim(triangles[face], centre)
        offset = np.abs(nearest - centre)
        own = np.max(offset, -1) <= 0.5
        found.append((texel[own], face[own], np.sum(offset[own] ** 2, -1), barycentric[own]))
    texel, face, distance, barycentric = (np.concatenate(parts) for parts in zip(*found, strict=True))
    best = np.lexsort((face, distance, texel))
    best = best[np.diff(texel[best], prepend=-1) > 0]
    owner[texel[best]], weights[texel[best]] = face[best], barycentric[best]
    valid = np.flatnonzero(owner < none)
    return valid, owner[valid], weights[valid]


def _pairs(
    triangles: np.ndarray, faces: np.ndarray, resolution: int, margin: float, wanted: np.ndarray | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (face (P,), texel (P,), centre (P, 2)) for every texel whose centre lies in a face's bounding box widened
    by `margin` texels, faces in ascending order, in batches. wanted: (R * R,) bool, the texels of interest."""
    low = np.ceil(triangles[faces].min(1) - margin - 0.5).clip(0, resolution).astype(int)
    high = np.floor(triangles[faces].max(1) + margin - 0.5).clip(-1, resolution - 1).astype(int)
    width, height = np.maximum(high - low + 1, 0).T
    ends = np.cumsum(width * height)
    start = 0
    while start < len(faces):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + _PAIRS_AT_ONCE, "right")))
        count = (width * height)[start:stop]
        which = np.repeat(np.arange(start, stop), count)
        nth = np.arange(len(which)) - np.repeat(ends[start:stop] - count - before, count)
        col = low[which, 0] + nth % width[which]
        row = low[which, 1] + nth // width[which]
        texel = row * resolution + col
        keep = slice(None) if wanted is None else wanted[texel]
        yield faces[which[keep]], texel[keep], np.stack([col[keep], row[keep]], -1) + 0.5
        start = stop


def _barycentric(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P, 3) weights of the corners of triangles (P, 3, 2) at points (P, 2); either winding."""
    a, b, c = (triangles[:, i] - points for i in range(3))
    parts = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], -1)
    return parts / np.sum(parts, -1, keepdims=True)


def _nearest_on_rim(triangles: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest point (P, 2) of each triangle's outline (P, 3, 2) to its point (P, 2), and its weights (P, 3)."""
    side = np.roll(triangles, -1, 1) - triangles
    along = np.sum((points[:, None] - triangles) * side, -1) / np.maximum(np.sum(side**2, -1), 1e-300)
    along = np.clip(along, 0, 1)
    candidates = triangles + along[..., None] * side
    best = np.argmin(np.sum((candidates - points[:, None]) ** 2, -1), 1)
    rows = np.arange(len(points))
    weights = np.zeros((len(points), 3))
    weights[rows, best] = 1 - along[rows, best]
    weights[rows, (best + 1) % 3] = along[rows, best]
    return candidates[rows, best], weights


def _morton(texel: np.ndarray, resolution: int) -> np.ndarray:
    """Place of each texel on a Z curve over the atlas: the bits of row and column interleaved."""

    def spread(bits: np.ndarray) -> np.ndarray:
        for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
            bits = (bits | bits << shift) & mask
        return bits

    return spread(texel % resolution) | spread(texel // resolution) << 1
