"""What stands in for networks and cameras where an avatar is driven live."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.live.drivers import Driver, Seen
from gavatar_runtime.values.body import SMPL_BODY_JOINTS


class Told(Driver):
    """A driver that is told who is there: `person` gives (22, 3) or None of the count of pictures so far."""

    lines = ((0, 1),)

    def __init__(self, person=lambda k: np.zeros((SMPL_BODY_JOINTS, 3))):
        self.person, self.times, self.resets = person, [], 0

    def __call__(self, image, time):
        pose = self.person(len(self.times))
        self.times.append(time)
        if pose is None:
            return None
        return Seen(pose, np.zeros(3), 0.8, np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([1.0, 0.2]))

    def reset(self):
        self.resets += 1


def raised(angle: float) -> np.ndarray:
    """(22, 3) the left arm turned about z."""
    pose = np.zeros((SMPL_BODY_JOINTS, 3))
    pose[16, 2] = angle
    return pose
