"""What joints can do: limits of each rotation and how far people usually are from the T-pose.

Numbers are axis-angle components in radians in the SMPL family's T-pose frames (x to the person's left, y up, z to the
front), for the left side; the right side mirrors y and z. They are generous ranges of motion from anatomy, rounded,
not fitted to data.
"""

from __future__ import annotations

import numpy as np

# name: (low, high, mean, standard deviation), three components each
_RANGES: dict[str, tuple] = {
    "spine1": ((-0.3, -0.4, -0.35), (0.8, 0.4, 0.35), (0.0, 0, 0), (0.12, 0.12, 0.1)),
    "spine2": ((-0.3, -0.4, -0.3), (0.6, 0.4, 0.3), (0.0, 0, 0), (0.1, 0.12, 0.1)),
    "spine3": ((-0.3, -0.4, -0.3), (0.5, 0.4, 0.3), (0.0, 0, 0), (0.1, 0.12, 0.1)),
    "neck": ((-0.5, -0.7, -0.4), (0.6, 0.7, 0.4), (0, 0, 0), (0.2, 0.25, 0.15)),
    "head": ((-0.5, -0.7, -0.4), (0.6, 0.7, 0.4), (0, 0, 0), (0.2, 0.25, 0.15)),
    "left_collar": ((-0.25, -0.35, -0.35), (0.25, 0.35, 0.5), (0, 0, -0.05), (0.08, 0.1, 0.12)),
    "left_shoulder": ((-1.6, -2.2, -1.7), (1.6, 1.3, 1.6), (0, 0, -0.8), (0.6, 0.8, 0.8)),
    "left_elbow": ((-1.4, -2.7, -0.15), (1.4, 0.02, 0.15), (0, -0.3, 0), (0.4, 0.8, 0.1)),
    "left_wrist": ((-0.6, -0.6, -1.2), (0.6, 0.6, 1.2), (0, 0, 0), (0.2, 0.2, 0.3)),
    "left_hip": ((-2.3, -0.9, -0.7), (0.8, 0.9, 1.0), (0, 0, -0.1), (0.6, 0.25, 0.25)),
    # the rest pose is bow-legged by 0.25 rad (SMPL's leg directions): z straightens it
    "left_knee": ((-0.02, -0.15, -0.05), (2.6, 0.15, 0.35), (0.05, 0, 0.15), (0.8, 0.1, 0.12)),
    "left_ankle": ((-0.7, -0.4, -0.4), (0.9, 0.4, 0.4), (0, 0, 0), (0.25, 0.15, 0.15)),
    "left_foot": ((-0.2, -0.02, -0.02), (0.5, 0.02, 0.02), (0, 0, 0), (0.1, 0.01, 0.01)),
}
_MIRROR = np.array([1.0, -1.0, -1.0])


def joint_ranges(joint_names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """low, high, mean and standard deviation, each (J, 3) axis-angle radians; the root is free (+-inf)."""
    low, high = np.full((len(joint_names), 3), -np.inf), np.full((len(joint_names), 3), np.inf)
    mean, sigma = np.zeros((len(joint_names), 3)), np.full((len(joint_names), 3), np.inf)
    for j, name in enumerate(joint_names):
        left = name.replace("right_", "left_")
        if left not in _RANGES:
            continue
        lo, hi, mu, sd = (np.array(v, np.float64) for v in _RANGES[left])
        if left != name:
            a, b = lo * _MIRROR, hi * _MIRROR
            lo, hi, mu = np.minimum(a, b), np.maximum(a, b), mu * _MIRROR
        low[j], high[j], mean[j], sigma[j] = lo, hi, mu, sd
    return low, high, mean, sigma
