"""The splatting rule written the slowest and plainest way: one Gaussian after another, float64, its exact bounding box.

Every rasterizer is held against this file, so it shares nothing with them but the constants of the rule.

The rule has thresholds, and a rasterizer that computes in float32 may fall on the other side of one. `render` says
where that can happen: `Reference.doubtful` marks the pixels at which some decision was closer than `slack`.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar_runtime.splatting_rule import ALPHA_MAX, ALPHA_MIN, FRUSTUM_MARGIN, LOW_PASS, NEAR, TRANSMITTANCE_STOP
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians, Rendering


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


@dataclasses.dataclass(frozen=True, eq=False)
class Reference(Rendering):
    """doubtful: (H, W) bool, pixels at which an alpha lay within a fraction `slack` of ALPHA_MIN, a transmittance
    within `slack` of TRANSMITTANCE_STOP, or two Gaussians drawn in turn within `depth_slack` of one depth."""

    doubtful: np.ndarray | None = None


def render(
    gaussians: Gaussians,
    camera: Camera,
    background=(1.0, 1.0, 1.0),
    *,
    alpha_max: float = ALPHA_MAX,
    slack: float = 0.0,
    depth_slack: float = 0.0,
    region: tuple[int, int, int, int] | None = None,
) -> Reference:
    """The picture in float64 from arrays of any float type.

    region: (top, left, height, width) of the part that is drawn, the whole if None. slack, depth_slack: fractions; 0
    marks no pixel. Gaussians at the very same mean are never in doubt: whatever rounds
    their depths rounds them alike.
    """
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

    top, left, *shape = region or (0, 0, camera.height, camera.width)
    color, depth, transmittance = np.zeros((*shape, 3)), np.zeros(shape), np.ones(shape)
    stopped, doubtful, last = np.zeros(shape, bool), np.zeros(shape, bool), np.full(shape, -1)
    for i in order:
        x, y, z = points[i]
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        covariance = covariance_2d(points[i], scales[i], None if quaternions is None else quaternions[i], camera)
        if not opacities[i] * (1 + slack) >= ALPHA_MIN:
            continue
        # the ellipse d^T conic d <= reach lies in |dx| <= sqrt(reach cov_xx), |dy| <= sqrt(reach cov_yy)
        reach = 2 * np.log(opacities[i] * (1 + slack) / ALPHA_MIN)
        half = np.sqrt(reach * np.diag(covariance)) + 1e-6
        window = tuple(
            slice(int(np.clip(np.floor(at - h), 0, size)), int(np.clip(np.ceil(at + h), 0, size)))
            for at, h, size in ((v - top, half[1], shape[0]), (u - left, half[0], shape[1]))
        )
        if window[0].start == window[0].stop or window[1].start == window[1].stop:
            continue
        dx = (np.arange(window[1].start, window[1].stop) + left + 0.5 - u)[None, :]
        dy = (np.arange(window[0].start, window[0].stop) + top + 0.5 - v)[:, None]
        conic = np.linalg.inv(covariance)
        power = conic[0, 0] * dx * dx + (conic[0, 1] + conic[1, 0]) * dx * dy + conic[1, 1] * dy * dy
        response = opacities[i] * np.exp(-0.5 * power)
        alpha = np.minimum(alpha_max, response)
        live, before = ~stopped[window], transmittance[window]
        touched = (alpha >= ALPHA_MIN) & live
        behind = before * (1 - alpha)
        stopping = touched & (behind < TRANSMITTANCE_STOP)
        blended = touched & ~stopping
        if slack:
            doubt = live & (np.abs(response - ALPHA_MIN) < slack * ALPHA_MIN)
            doubt |= touched & (np.abs(behind - TRANSMITTANCE_STOP) < slack * TRANSMITTANCE_STOP)
            previous = last[window]
            near = touched & (previous >= 0) & (z - points[previous, 2] < depth_slack * z)
            doubt |= near & (means[previous] != means[i]).any(-1)
            doubtful[window] |= doubt
            last[window] = np.where(touched, i, previous)
        stopped[window] |= stopping
        weight = np.where(blended, alpha * before, 0)
        color[window] += weight[..., None] * colors[i]
        depth[window] += weight * z
        transmittance[window] = np.where(blended, behind, before)
    color += transmittance[..., None] * np.asarray(background, np.float64)
    return Reference(color, 1 - transmittance, depth, int((~finite).sum()), doubtful)
