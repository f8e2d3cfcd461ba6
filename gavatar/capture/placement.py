"""How the poses of somebody else's capture become a motion of a body here.

Three things differ between data sets and are settled here exactly. Where a translation starts: from the rest pelvis
that the root turns about (smplx, gavatar) or from the model's origin (EasyMocap, NeuMan). Which way is up: gavatar's
world is y-up, a camera's is not. And which body the numbers belong to: on another body the shape is left out and the
pelvis is put where it was.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, rotation_between
from gavatar_runtime.motions.upright import MEAN_PELVIS, Y_UP_FROM, vertical_axis
from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

# Bodies whose betas and rest pelvis mean what a family's do: SMPL-H is SMPL with hands
SAME_SHAPES = {"smpl": ("smpl", "smplh"), "smplh": ("smplh", "smpl"), "smplx": ("smplx",)}


@dataclasses.dataclass(frozen=True)
class Placement:
    """source: the motion as the data set gives it, in its own world. family: of the body it was made with.

    turn: (3, 3) from the data set's world to the y-up one. pivots: (T, 3, 3) the rotations that the model's origin is
    turned by before `trans` is added, so that the pelvis stands at pivot @ rest pelvis + trans; None where the root
    turns about the rest pelvis, which then stands at rest pelvis + trans.
    """

    source: Motion
    family: str
    turn: np.ndarray
    pivots: np.ndarray | None = None

    def motion(self, body: BodyData | None = None) -> Motion:
        """The motion of a body, y-up; None: of a mean body of the family."""
        poses = self.source.poses.astype(np.float64)
        betas = self.source.betas
        if body is None or body.name not in SAME_SHAPES[self.family]:
            then = np.array(MEAN_PELVIS[self.family])
            now = then if body is None else body.shaped(None)[1][0]
            betas = betas if body is None else None
        else:
            then = now = body.shaped(betas)[1][0]
        offset = then if self.pivots is None else self.pivots @ then
        pelvis = (self.source.trans + offset) @ self.turn.T
        poses[:, 0] = axis_angle_from_matrix(self.turn @ matrix_from_axis_angle(poses[:, 0]))
        return dataclasses.replace(
            self.source, poses=poses.astype(np.float32), trans=(pelvis - now).astype(np.float32), betas=betas
        )

    def camera(self, camera: Camera) -> Camera:
        """A camera of the data set's world in the y-up one."""
        T = camera.T_camera_world.copy()
        T[:3, :3] = T[:3, :3] @ self.turn.T
        return dataclasses.replace(camera, T_camera_world=T)


def upright(poses: np.ndarray) -> np.ndarray:
    """(3, 3) from a world with axis-aligned gravity to the y-up one, told by the mean pelvis of poses (T, J, 3)."""
    return Y_UP_FROM[vertical_axis(poses)]


def levelled(poses: np.ndarray) -> np.ndarray:
    """(3, 3) the least rotation that takes the mean direction that the pelvis points up along to +y, for worlds whose
    axes mean nothing (structure from motion); the identity where the pelvis points everywhere."""
    mean = matrix_from_axis_angle(poses[:, 0].astype(np.float64))[:, :, 1].mean(0)
    if np.linalg.norm(mean) < 0.1:
        return np.eye(3)
    return rotation_between(mean, np.array([0.0, 1.0, 0.0]))
