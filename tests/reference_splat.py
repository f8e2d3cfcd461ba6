"""The splatting rule written the slowest and plainest way: one Gaussian after another, float64, its exact bounding box.

Every rasterizer is held against this file, so it shares nothing with them but the constants of the rule.
"""

from __future__ import annotations

import numpy as np
from gavatar_runtime.camera import Camera
from gavatar_runtime.gaussians import Gaussians, Rendering
from gavatar_runtime.rasterizers.rules import ALPHA_MAX, ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, NEAR, TRANSMITTANCE_STOP


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """(3, 3) from (4,) wxyz, by rotating the basis vectors: v + 2 w (u x v) + 2 u x (u x v)."""
    norm = np.linalg.norm(quaternion)
    if norm == 0:
        return np.eye(3)
    w, u = quaternion[0] / norm, quaternion[1:] / norm
    columns = [v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v)) for v in np.eye(3)]
    return np.stack(columns, 1)


def covariance_2d(point, scale, quaternion, camera: Camera) -> np.ndarray:
    """(2, 2) px^2 of one Gaussian at camera point (3,)."""
    x, y, z = point
    half_width, half_height = camera.width / 2, camera.height / 2
    left, right = -FRUSTUM_MARGIN * half_width, camera.width + FRUSTUM_MARGIN * half_width
    top, bottom = -FRUSTUM_MARGIN * half_height, camera.height + FRUSTUM_MARGIN * half_height
    ratio_x = min(max(x / z, (left - camera.cx) / camera.fx), (right - camera.cx) / camera.fx)
    ratio_y = min(max(y / z, (top - camera.cy) / camera.fy), (bottom - camera.cy) / camera.fy)
    jacobian = np.array([[camera.fx / z, 0, -camera.fx * ratio_x / z], [0, camera.fy / z, -camera.fy * ratio_y / z]])
    rotation = np.eye(3) if quaternion is None else rotation_matrix(quaternion)
    sigma = rotation @ np.diag(np.broadcast_to(scale, 3) ** 2.0) @ rotation.T
    world_to_camera = camera.T_camera_world[:3, :3]
    return jacobian @ world_to_camera @ sigma @ world_to_camera.T @ jacobian.T + LOW_PASS * np.eye(2)


def render(gaussians: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0)) -> Rendering:
    """The picture in float64 from arrays of any float type."""
    means, scales, colors = (np.asarray(v, np.float64) for v in (gaussians.means, gaussians.scales, gaussians.colors))
    opacities = np.ones(len(means)) if gaussians.opacities is None else np.asarray(gaussians.opacities, np.float64)
    quaternions = None if gaussians.quaternions is None else np.asarray(gaussians.quaternions, np.float64)
    finite = np.array([np.isfinite(means[i]).all() and np.isfinite(scales[i]).all() and np.all(scales[i] >= 0)
                       and np.isfinite(colors[i]).all() and np.isfinite(opacities[i])
                       and (quaternions is None or np.isfinite(quaternions[i]).all())
                       for i in range(len(means))], bool)  # fmt: skip
    points = means @ camera.T_camera_world[:3, :3].T + camera.T_camera_world[:3, 3]
    front = np.flatnonzero(finite & (points[:, 2] > NEAR))
    order = front[np.argsort(points[front, 2].astype(np.float32), kind="stable")]

    color = np.zeros((camera.height, camera.width, 3))
    depth = np.zeros((camera.height, camera.width))
    transmittance = np.ones((camera.height, camera.width))
    stopped = np.zeros((camera.height, camera.width), bool)
    for i in order:
        x, y, z = points[i]
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        covariance = covariance_2d(points[i], scales[i], None if quaternions is None else quaternions[i], camera)
        if not opacities[i] >= ALPHA_MIN:
            continue
        # the ellipse d^T conic d <= reach lies in |dx| <= sqrt(reach cov_xx), |dy| <= sqrt(reach cov_yy)
        reach = 2 * np.log(opacities[i] / ALPHA_MIN)
        half = np.sqrt(reach * np.diag(covariance)) + 1e-6
        columns = slice(int(np.clip(np.floor(u - half[0]), 0, camera.width)),
                        int(np.clip(np.ceil(u + half[0]), 0, camera.width)))  # fmt: skip
        rows = slice(int(np.clip(np.floor(v - half[1]), 0, camera.height)),
                     int(np.clip(np.ceil(v + half[1]), 0, camera.height)))  # fmt: skip
        dx = (np.arange(columns.start, columns.stop) + 0.5 - u)[None, :]
        dy = (np.arange(rows.start, rows.stop) + 0.5 - v)[:, None]
        conic = np.linalg.inv(covariance)
        power = conic[0, 0] * dx * dx + (conic[0, 1] + conic[1, 0]) * dx * dy + conic[1, 1] * dy * dy
        alpha = np.minimum(ALPHA_MAX, opacities[i] * np.exp(-0.5 * power))
        touched = (alpha >= ALPHA_MIN) & ~stopped[rows, columns]
        behind = transmittance[rows, columns] * (1 - alpha)
        stopping = touched & (behind < TRANSMITTANCE_STOP)
        stopped[rows, columns] |= stopping
        blended = touched & ~stopping
        weight = np.where(blended, alpha * transmittance[rows, columns], 0)
        color[rows, columns] += weight[..., None] * colors[i]
        depth[rows, columns] += weight * z
        transmittance[rows, columns] = np.where(blended, behind, transmittance[rows, columns])
    color += transmittance[..., None] * np.asarray(background, np.float64)
    return Rendering(color, 1 - transmittance, depth, dropped=int((~finite).sum()))
