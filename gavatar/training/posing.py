"""A trained avatar in the poses of any motion."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gavatar_runtime.values.body import check_motion_fits
from gavatar_runtime.values.gaussians import Gaussians
from gavatar_runtime.values.motion import Motion

from ..assemble import AvatarBuild
from ..attributes import Attributes
from ..avatar.trainable import Avatar
from .motion_table import MotionTable
from .run import Run


@torch.no_grad()
def pose_features(avatar: Avatar, built: AvatarBuild, poses: np.ndarray) -> Tensor | None:
    """Pose features of (B, J, 3) axis-angle poses, or None for a static avatar."""
    if avatar.encoder is None:
        return None
    return avatar.encode(*built.encoder_tensors(poses))


@torch.no_grad()
def attributes_in(run: Run, motion: Motion, frame: int) -> Attributes:
    """What the run's decoder says of every point in the pose of one frame of `motion`."""
    poses = check_motion_fits(motion.taken([frame]).poses, run.built.body.data.num_joints)
    return run.avatar.attributes(pose_features(run.avatar, run.built, poses))


@torch.no_grad()
def posed(run: Run, motion: Motion, frame: int) -> Gaussians:
    """The trained avatar's Gaussians in the pose of one frame of `motion`, torch tensors."""
    table = MotionTable(motion.taken([frame]), run.built.body.data.num_joints).to(run.avatar.features.device)
    return run.avatar.pose(attributes_in(run, motion, frame), table())[0]
