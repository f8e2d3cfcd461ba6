"""Drawing a posed body over images, in software."""

from __future__ import annotations

import cv2
import numpy as np

from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.camera import Camera

_SUBPIXEL = 4  # bits of cv2's fixed-point coordinates


def project_body(
    data: BodyData, camera: Camera, poses: np.ndarray, betas: np.ndarray | None, trans: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) projected vertices (x, y pixels, depth) and (V, 3) world vertices of one pose (J, 3)."""
    vertices, _ = data.posed(poses, betas, trans)
    return camera.project(vertices), vertices


def _polygons(projected: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Front-facing triangles before the camera, far to near: their numbers and fixed-point corners (F, 3, 2)."""
    corners = projected[faces]
    a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    front = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0) & (corners[..., 2] > 0.05).all(1)
    number = np.flatnonzero(front)
    number = number[np.argsort(-corners[number, :, 2].mean(1), kind="stable")]
    # pixel centres are at +0.5 here and at whole numbers in cv2
    fixed = np.clip((corners[number, :, :2] - 0.5) * 2**_SUBPIXEL, -(2**26), 2**26)
    return number, np.round(fixed).astype(np.int32)


def body_mask(
    data: BodyData, camera: Camera, poses: np.ndarray, betas: np.ndarray | None, trans: np.ndarray | None
) -> np.ndarray:
    """(H, W) uint8, 255 where the body is."""
    projected, _ = project_body(data, camera, poses, betas, trans)
    mask = np.zeros((camera.height, camera.width), np.uint8)
    for polygon in _polygons(projected, data.faces)[1]:
        cv2.fillConvexPoly(mask, polygon, 255, shift=_SUBPIXEL)
    return mask


def overlay(
    image: np.ndarray, data: BodyData, camera: Camera, poses: np.ndarray, betas: np.ndarray | None,
    trans: np.ndarray | None, opacity: float = 0.6,
) -> np.ndarray:  # fmt: skip
    """The body, shaded, over a copy of `image` (H, W, 3) uint8 BGR. The left half of the body is blue, the right half
    orange, so that an exchange of sides or a flip shows at a glance."""
    projected, vertices = project_body(data, camera, poses, betas, trans)
    normals = np.cross(vertices[data.faces[:, 1]] - vertices[data.faces[:, 0]],
                       vertices[data.faces[:, 2]] - vertices[data.faces[:, 0]])  # fmt: skip
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    view = camera.position - vertices[data.faces[:, 0]]
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    shade = 0.35 + 0.65 * np.clip((normals * view).sum(-1), 0, 1)
    left = data.v_template[data.faces, 0].mean(1) > 0
    colors = np.where(left[:, None], [230, 150, 70], [70, 150, 240]) * shade[:, None]
    drawn, mask = image.copy(), np.zeros(image.shape[:2], np.uint8)
    numbers, polygons = _polygons(projected, data.faces)
    for number, polygon in zip(numbers, polygons, strict=True):
        cv2.fillConvexPoly(drawn, polygon, colors[number].tolist(), shift=_SUBPIXEL)
        cv2.fillConvexPoly(mask, polygon, 255, shift=_SUBPIXEL)
    blended = cv2.addWeighted(drawn, opacity, image, 1 - opacity, 0)
    return np.where(mask[..., None] > 0, blended, image)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two boolean masks; 1 when both are empty."""
    union = np.logical_or(a, b).sum()
    return float(np.logical_and(a, b).sum() / union) if union else 1.0


def contact_sheet(images: list[np.ndarray], columns: int = 6, width: int = 240) -> np.ndarray:
    """Images of one size laid out in rows, each `width` pixels wide."""
    height = max(1, round(images[0].shape[0] * width / images[0].shape[1]))
    small = [cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in images]
    columns = min(columns, len(small))
    small += [np.full_like(small[0], 255)] * (-len(small) % columns)
    return np.vstack([np.hstack(small[k : k + columns]) for k in range(0, len(small), columns)])
