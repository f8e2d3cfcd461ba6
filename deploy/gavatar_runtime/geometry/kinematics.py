"""Forward kinematics and linear blend skinning in NumPy (SMPL, Loper et al. 2015, equations 2 to 7)."""

from __future__ import annotations

import numpy as np

from .rotations import matrix_from_axis_angle

_POINTS_AT_ONCE = 4096  # their blended matrices stay in the processor's cache: twice as fast as all at once


def joint_transforms(poses: np.ndarray, joints: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """World transform of every joint of a posed skeleton.

    poses: (..., J, 3) axis-angle of each joint relative to its parent, radians. joints: (J, 3) rest positions, metres.
    parents: (J,) int, -1 for the root; a parent stands before its children.
    Returns T_world_joint: (..., J, 4, 4), without the global translation.
    """
    rotations = matrix_from_axis_angle(poses)
    joints = np.asarray(joints, rotations.dtype)
    T = np.zeros((*rotations.shape[:-2], 4, 4), rotations.dtype)
    T[..., 3, 3] = 1
    for j, parent in enumerate(parents):
        if parent < 0:
            T[..., j, :3, :3] = rotations[..., j, :, :]
            T[..., j, :3, 3] = joints[j]
        else:
            T[..., j, :3, :3] = T[..., parent, :3, :3] @ rotations[..., j, :, :]
            T[..., j, :3, 3] = T[..., parent, :3, :3] @ (joints[j] - joints[parent]) + T[..., parent, :3, 3]
    return T


def skinning_transforms(T_world_joint: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(..., J, 4, 4) rest-to-posed transforms: T_world_joint composed with the inverse of the joint's rest place."""
    A = T_world_joint.copy()
    A[..., :3, 3] -= np.einsum("...jab,jb->...ja", T_world_joint[..., :3, :3], joints)
    return A


def moved_rest(A: np.ndarray, joints: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Rest-to-posed transforms (J, 4, 4) of the same rotations as in `A` for a skeleton whose rest joints (J, 3) lie
    elsewhere."""
    R, out, place = A[:, :3, :3], A.copy(), np.array(joints, np.float64)
    for j, parent in enumerate(parents):
        if parent >= 0:
            place[j] = place[parent] + R[parent] @ (joints[j] - joints[parent])
    out[:, :3, 3] = place - np.einsum("jab,jb->ja", R, joints)
    return out


def invert_rigid(T: np.ndarray) -> np.ndarray:
    """Inverse of rigid transforms (..., 4, 4), by transposition (never by a general solve)."""
    inverse = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = Rt
    inverse[..., :3, 3] = -np.einsum("...ab,...b->...a", Rt, T[..., :3, 3])
    inverse[..., 3, 3] = 1
    return inverse


def skin(points: np.ndarray, joint_index: np.ndarray, joint_weight: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Linear blend skinning with sparse weights.

    points: (N, 3) metres, in the frame A maps from. joint_index: (N, K) int; joint_weight: (N, K), rows sum to 1,
    unused entries have weight 0. A: (J, 4, 4). Returns (N, 3).
    """
    out = np.zeros_like(points)
    rows = A[:, :3].reshape(len(A), 12)
    for start in range(0, len(points), _POINTS_AT_ONCE):
        part = slice(start, start + _POINTS_AT_ONCE)
        index, weight = joint_index[part], joint_weight[part]
        M = np.zeros((len(index), 12), rows.dtype)
        for k in range(index.shape[1]):
            term = rows.take(index[:, k], 0)
            term *= weight[:, k, None]
            M += term
        x, y, z = points[part].T
        for a in range(3):
            out[part, a] = M[:, 4 * a] * x + M[:, 4 * a + 1] * y + M[:, 4 * a + 2] * z + M[:, 4 * a + 3]
    return out
