"""Arrays and .npz files of motions for tests."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.values.motion import Motion


def numbers(*shape, seed=0, scale=0.3):
    return np.random.default_rng(seed).normal(0, scale, shape).astype(np.float32)


def parts(frames=2, **fields):
    """The fields of a body without hands, and others."""
    return {"global_orient": numbers(frames, 3), "body_pose": numbers(frames, 63), "mocap_framerate": 30, **fields}


def amass(path, **changes):
    """An AMASS file of 4 frames and 52 joints, with entries changed, added or (None) left out."""
    rng = np.random.default_rng(0)
    entries = {
        "poses": rng.normal(0, 0.3, (4, 156)),
        "trans": rng.normal(0, 1, (4, 3)),
        "betas": np.zeros(16),
        "mocap_framerate": np.float64(60),
        "gender": np.array("male"),
    } | changes
    np.savez(path, **{k: v for k, v in entries.items() if v is not None})
    return path


def nan_from(frame, shape):
    values = np.zeros(shape)
    values[frame:] = np.nan
    return values


def rotations_of(motion: Motion, joints: int = 22) -> np.ndarray:
    """(T, joints, 3, 3) of a motion's first joints, in double precision."""
    return matrix_from_axis_angle(motion.poses[:, :joints].astype(np.float64))


def walk(frames: int = 12, joints: int = 24, seed: int = 0) -> dict[str, np.ndarray]:
    """poses (T, J, 3) axis-angle of an upright person, y-up, trans (T, 3) of a walk, betas (10,), float32."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0, 2, frames)[:, None, None]
    poses = rng.normal(0, 0.25, (1, joints, 3)) + 0.2 * np.sin(phase * rng.normal(1, 0.3, (1, joints, 3)))
    poses[:, 0] = np.stack([0 * phase[:, 0, 0], 0.4 * phase[:, 0, 0], 0 * phase[:, 0, 0]], -1)
    trans = np.stack([phase[:, 0, 0], 0 * phase[:, 0, 0] + 0.9, 0.5 * phase[:, 0, 0]], -1)
    betas = np.arange(10) / 10
    return {name: array.astype(np.float32) for name, array in (("poses", poses), ("trans", trans), ("betas", betas))}


def assert_same_rotations(motion: Motion, poses: np.ndarray, joints: int = 22) -> None:
    """The first joints of the motion turn as poses (T, J, 3) do, within 1e-4 radians: float32 matrices and back."""
    assert len(motion) == len(poses)
    there = matrix_from_axis_angle(poses[:, :joints].astype(np.float64))
    between = np.swapaxes(there, -1, -2) @ rotations_of(motion, joints)
    angle = np.linalg.norm(axis_angle_from_matrix(between), axis=-1)
    assert angle.max() < 1e-4, angle.max(0)
