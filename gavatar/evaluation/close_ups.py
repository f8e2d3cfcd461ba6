"""What a person looks at first: the face, a hand, the hem, the back, each from near by."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch

from gavatar_runtime.geometry.kinematics import joint_transforms
from gavatar_runtime.render.widening import as_trained
from gavatar_runtime.values.camera import Camera, look_at
from gavatar_runtime.values.motion import Motion

from ..assemble import build_rasterizer
from ..training.motion_table import MotionTable
from ..training.posing import attributes_in
from ..training.run import Run
from ..training.scene import WHITE

FIELD_OF_VIEW = np.deg2rad(20)  # as a portrait lens has


@dataclasses.dataclass(frozen=True)
class CloseUp:
    """A place on the body to be looked at. joint: near it. turned: radians about the vertical that the camera stands
    from straight before that joint. height: metres that the target lies above the joint, along the joint's own upward
    axis. size: metres that the picture spans."""

    title: str
    joint: str
    turned: float
    height: float
    size: float


CLOSE_UPS = (
    CloseUp("face", "head", 0.0, 0.07, 0.36),
    CloseUp("hand", "left_wrist", 0.0, 0.0, 0.40),
    CloseUp("hem", "pelvis", 0.35, -0.12, 0.60),
    CloseUp("back", "spine2", np.pi, 0.0, 0.70),
)


def close_up_cameras(
    joints: Sequence[str], transforms: np.ndarray, trans: np.ndarray, pixels: int
) -> list[tuple[str, Camera]]:
    """A camera of `pixels` x `pixels` for each of `CLOSE_UPS` whose joint the body has, with its title.

    joints: names of the body's J joints. transforms: (J, 4, 4) world from joint without translation, metres, as
    `joint_transforms` gives; a joint's own axes at rest are x to the person's left, y up, z forward.
    trans: (3,), metres.
    """
    cameras = []
    for close_up in CLOSE_UPS:
        if close_up.joint not in joints:
            continue
        place = transforms[list(joints).index(close_up.joint)]
        # a hand turns every way: it is looked at as the trunk stands
        facing = place if close_up.joint != "left_wrist" else transforms[list(joints).index("pelvis")]
        target = place[:3, 3] + trans + close_up.height * facing[:3, 1]
        forward = np.array([facing[0, 2], 0.0, facing[2, 2]])
        length = np.linalg.norm(forward)
        forward = forward / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])  # lying: from the world's front
        cos, sin = np.cos(close_up.turned), np.sin(close_up.turned)
        direction = np.array([cos * forward[0] + sin * forward[2], 0.0, cos * forward[2] - sin * forward[0]])
        focal = pixels / (2 * np.tan(FIELD_OF_VIEW / 2))
        eye = target + direction * close_up.size * focal / pixels
        middle = pixels / 2
        cameras.append((close_up.title, Camera(pixels, pixels, focal, focal, middle, middle, look_at(eye, target))))
    return cameras


@torch.no_grad()
def close_ups(
    run: Run, motion: Motion, frame: int, pixels: int = 256, background: torch.Tensor = WHITE
) -> dict[str, np.ndarray]:
    """Pictures (pixels, pixels, 3) of the run's avatar from near by in the pose of one frame of `motion`, by title."""
    avatar, data = run.avatar, run.built.body.data
    surface = avatar.surface
    taken = motion.taken([frame])
    poses = np.asarray(taken.poses[0], np.float64).reshape(-1, 3)
    transforms = joint_transforms(poses, surface.joints, surface.parents)
    gaussians = avatar.pose(attributes_in(run, motion, frame), MotionTable(taken, data.num_joints)())[0]
    rasterize = build_rasterizer(run.config.rasterizer, avatar)
    pictures = {}
    for title, camera in close_up_cameras(list(data.joint_names), transforms, np.asarray(taken.trans[0]), pixels):
        drawn = rasterize(as_trained(gaussians, camera, run.pixel), camera, background)
        pictures[title] = drawn.color.clamp(0, 1).cpu().numpy()
    return pictures
