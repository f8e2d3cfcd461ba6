"""People on the free body whose motion is known, what a detector would say of them, and how far a fit is off."""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar.preparation.anatomy import joint_ranges
from gavatar.preparation.draw import body_mask
from gavatar.preparation.fit import FitOptions
from gavatar.preparation.landmarks import INDEX, Landmarks, landmark_rows
from gavatar_runtime.values.camera import Camera, look_at

QUICK = FitOptions(steps=(40, 80, 40), surface_points=400)
FPS = 10.0


@dataclasses.dataclass
class Truth:
    poses: np.ndarray
    trans: np.ndarray
    betas: np.ndarray
    joints: np.ndarray  # (T, 22, 3)
    points: np.ndarray  # (T, 33, 3) landmarks


def truth_of(data, poses, trans, betas) -> Truth:
    regressor, weights = landmark_rows(data)
    joints, points = [], []
    for pose, shift in zip(poses, trans, strict=True):
        A = data.skinning(pose, betas)
        rest = regressor @ data.shaped(betas)[0]
        points.append(np.einsum("kj,jab,kb->ka", weights, A[:, :3], np.c_[rest, np.ones(33)]) + shift)
        joints.append(data.posed(pose, betas, shift)[1][:22])
    return Truth(poses, trans, betas, np.array(joints), np.array(points))


def plausible_motion(data, frames=16, turn=2 * np.pi, seed=0) -> Truth:
    """A person who turns by `turn` while arms and legs move within what joints can do."""
    rng = np.random.default_rng(seed)
    low, high, mean, sigma = joint_ranges(tuple(data.joint_names))
    poses = np.zeros((frames, data.num_joints, 3))
    time = np.linspace(0, 1, frames)[:, None]
    for j in range(1, 22):
        swing = rng.normal(size=(2, 3)) * np.minimum(sigma[j], 0.3)
        path = mean[j] + swing[0] * np.sin(2 * time) + swing[1] * np.cos(3 * time)
        poses[:, j] = np.clip(path, low[j], high[j])
    poses[:, 0, 1] = np.linspace(0, turn, frames)
    trans = np.concatenate([0.1 * np.sin(3 * time), 0 * time, 0.1 * time], 1)
    betas = np.concatenate([rng.normal(size=4) * 0.5, np.zeros(data.num_betas - 4)])
    return truth_of(data, poses, trans, betas)


def turning_with_bent_arms(data, frames=12) -> Truth:
    """Half a turn with the forearms bending forward: each points to the camera first and away from it at the end."""
    time, names = np.linspace(0, 1, frames), list(data.joint_names)
    poses = np.zeros((frames, data.num_joints, 3))
    poses[:, 0, 1] = np.pi * time
    for side, sign in (("left", 1), ("right", -1)):
        poses[:, names.index(f"{side}_shoulder")] = [0, -0.9 * sign, -0.9 * sign]
        poses[:, names.index(f"{side}_elbow"), 1] = -sign * (0.3 + 1.2 * time)
    return truth_of(data, poses, np.zeros((frames, 3)), np.zeros(data.num_betas))


def seen_by(camera: Camera, truth: Truth, pixel_noise=1.0, depth_noise=0.02, seed=1) -> Landmarks:
    """What a detector would say: image points with noise, and points around the hips along the camera's axes."""
    rng = np.random.default_rng(seed)
    image = camera.project(truth.points)[..., :2]
    hips = truth.points[:, [INDEX["left_hip"], INDEX["right_hip"]]].mean(1, keepdims=True)
    world = (truth.points - hips) @ camera.T_camera_world[:3, :3].T
    return Landmarks(
        image + pixel_noise * rng.normal(size=image.shape),
        np.ones(image.shape[:2]),
        world + depth_noise * rng.normal(size=world.shape),
        FPS,
        camera.width,
        camera.height,
    )


def cameras_around(count: int) -> list[Camera]:
    places = ((0, 0.3, 4.0), (3.5, 0.5, 1.5), (-3.0, 0.2, -2.0))[:count]
    return [Camera(256, 256, 380.0, 380.0, 128.0, 128.0, look_at(p, (0, -0.1, 0))) for p in places]


def masks_of(data, camera, truth):
    return [body_mask(data, camera, p, truth.betas, t) for p, t in zip(truth.poses, truth.trans, strict=True)]


def joint_error(data, fit, truth) -> float:
    """Root-aligned mean joint error over all frames, metres."""
    errors = []
    for pose, trans, joints in zip(fit.poses, fit.trans, truth.joints, strict=True):
        found = data.posed(pose, fit.betas, trans)[1][:22]
        errors.append(np.linalg.norm((found - found[0]) - (joints - joints[0]), axis=-1).mean())
    return float(np.mean(errors))
