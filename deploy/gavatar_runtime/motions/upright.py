"""Which way is up in a motion's world, and the same motion in a y-up one."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..errors import WrongValue
from ..geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from ..values.motion import Motion

# (3,) metres: the rest pelvis of the mean body of a family, to two digits
MEAN_PELVIS = {"smpl": (0.0, -0.23, 0.03), "smplh": (0.0, -0.23, 0.03), "smplx": (0.0, -0.35, 0.01)}

# rows: the axes of a y-up world in the file's world
Y_UP_FROM = {
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-y": np.diag([1.0, -1, -1]),  # a camera's own axes: y down, z forward
}


def check_up(up: str) -> None:
    """UserError unless `up` is auto or one of the axes of `Y_UP_FROM`."""
    if up not in ("auto", *Y_UP_FROM):
        raise WrongValue(f"`up={up}`: choose from auto, {', '.join(Y_UP_FROM)}")


def vertical_axis(poses: np.ndarray) -> str:
    """The axis (`y`, `z` or `-y`) that the pelvis' own up axis points along on average over the frames."""
    up = matrix_from_axis_angle(poses[:, 0].astype(np.float64))[:, :, 1].mean(0)
    if up[2] > abs(up[1]):
        return "z"
    return "-y" if up[1] < -0.5 else "y"


def y_up(motion: Motion, up: str = "auto") -> Motion:
    """The same motion in a y-up world; up: the axis that is vertical now, `auto` finds it.

    The pelvis' rest offset is left out of the turn: it depends on the body and shifts every frame alike.
    """
    up = vertical_axis(motion.poses) if up == "auto" else up
    if up == "y":
        return motion
    turn = Y_UP_FROM[up]
    poses = motion.poses.copy()
    poses[:, 0] = axis_angle_from_matrix(turn @ matrix_from_axis_angle(poses[:, 0].astype(np.float64)))
    return dataclasses.replace(motion, poses=poses, trans=(motion.trans @ turn.T).astype(np.float32))
