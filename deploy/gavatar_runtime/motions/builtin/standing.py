"""The pose at ease that built-in motions start from, and what all of them are made with.

Angles are relative to the T-pose of an SMPL-H skeleton that faces +z with its left arm along +x. Mirroring a joint's
rotation keeps its x and negates y and z.
"""

from __future__ import annotations

import numpy as np

from ...errors import UserError
from ...geometry.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle, quaternion_product
from ...values.motion import Motion
from ...values.skeletons import FINGERS, SMPLH

# Degrees about x, y, z of left-hand joints; the right side mirrors them. A standing person's arms hang a palm's width
# off the hips, turned in by their own weight, elbows and fingers never quite straight.
RELAXED_LEFT = {
    "left_collar": (0, 0, -5),
    "left_shoulder": (0, -6, -53),
    "left_elbow": (0, -18, -8),
    "left_wrist": (0, -4, -4),
    "left_hip": (0, 4, -4),
    "left_knee": (0, 0, 4),
}
FINGER_CURL = {"index": 14, "middle": 18, "ring": 21, "pinky": 22}  # degrees a phalanx, about z
MAX_FRAMES = 1_000_000


def relaxed_pose() -> np.ndarray:
    """(52, 3) axis-angle of a person standing at ease, SMPL-H order, radians."""
    pose = np.zeros((len(SMPLH), 3))
    for name, degrees in RELAXED_LEFT.items():
        left = np.radians(degrees)
        pose[SMPLH.index(name)] = left
        pose[SMPLH.index(name.replace("left", "right"))] = left * (1, -1, -1)
    for name in FINGERS:
        side, finger = name.split("_")
        curl = np.radians(FINGER_CURL.get(finger[:-1], 0))
        pose[SMPLH.index(name), 2] = -curl if side == "left" else curl
    return pose


def composed(*degrees: np.ndarray) -> np.ndarray:
    """(..., 3) axis-angle of rotations applied from the last to the first, each (..., 3) in degrees about one axis or
    several."""
    first, *rest = (quaternion_from_axis_angle(np.radians(d)) for d in degrees)
    for q in rest:
        first = quaternion_product(first, q)
    return axis_angle_from_quaternion(first)


def loop_phase(name: str, seconds: float, fps: float) -> np.ndarray:
    """(T,) in [0, 1): the loop's phase at each frame, at least one frame."""
    for key, value in (("seconds", seconds), ("fps", fps)):
        if not (isinstance(value, (int, float)) and 0 < value < np.inf):
            raise UserError(f"motion '{name}': {key}={value} must be a positive number")
    frames = max(1, round(seconds * fps))
    if frames > MAX_FRAMES:
        raise UserError(f"motion '{name}': {seconds:g} s at {fps:g} frames per second is more than {MAX_FRAMES} frames")
    return np.arange(frames) / frames


def motion_of(name: str, poses: np.ndarray, trans: np.ndarray, fps: float) -> Motion:
    """float32 arrays as a motion."""
    return Motion(poses.astype(np.float32), trans.astype(np.float32), float(fps), name=name)
