"""A motion: poses of an SMPL-family skeleton over time."""

from __future__ import annotations

import dataclasses

import numpy as np

from .rotations import axis_angle_from_quaternion, quaternion_from_axis_angle, slerp


@dataclasses.dataclass
class Motion:
    """T frames of a skeleton of J joints.

    poses: (T, J, 3) axis-angle relative to the parent joint, radians. trans: (T, 3) metres, added after posing.
    fps: frames per second. betas: (B,) shape coefficients or None. name: for messages and file names.
    leg_length: metres from hip to ankle of the person whose `trans` this is, where that person is not the body's shape;
    a body that plays the motion walks in proportion to its own legs. None leaves `trans` alone.
    """

    poses: np.ndarray
    trans: np.ndarray
    fps: float
    betas: np.ndarray | None = None
    name: str = "motion"
    leg_length: float | None = None

    def __len__(self) -> int:
        return len(self.poses)

    def resampled(self, fps: float) -> Motion:
        """The motion at another frame rate: slerp per joint, linear translation; the first and last time are kept as
        far as the new rate allows. One frame stays one frame."""
        if len(self) < 2 or fps == self.fps:
            return dataclasses.replace(self, fps=fps)
        count = int(np.floor((len(self) - 1) / self.fps * fps + 1e-6)) + 1
        time = np.minimum(np.arange(count) / fps * self.fps, len(self) - 1)
        low = np.minimum(time.astype(int), len(self) - 2)
        fraction = time - low
        q = quaternion_from_axis_angle(self.poses.astype(np.float64))
        poses = axis_angle_from_quaternion(slerp(q[low], q[low + 1], fraction[:, None]))
        trans = self.trans[low] * (1 - fraction[:, None]) + self.trans[low + 1] * fraction[:, None]
        return dataclasses.replace(
            self, poses=poses.astype(self.poses.dtype), trans=trans.astype(self.trans.dtype), fps=fps
        )
