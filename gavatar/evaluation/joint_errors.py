"""How far the joints of a motion are from those of the truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch

from gavatar_runtime.values.body import check_motion_fits
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.skeletons import FINGERS

from ..assemble import AvatarBuild
from ..images.metrics import joint_errors, mpjpe_hands, rotation_errors
from ..training.motion_table import MotionTable


@dataclasses.dataclass
class PartErrors:
    """Errors of what the 22 body joints leave out, each None where the truth holds it still. mpjpe_hands_mm: of finger
    joints, from their wrist. jaw_deg: of the jaw's rotation, whose joint itself hardly moves."""

    mpjpe_hands_mm: float | None = None
    jaw_deg: float | None = None

    def as_json(self, prefix: str = "", when: str = "") -> dict[str, float | None]:
        """The two numbers under `{prefix}mpjpe_hands{when}_mm` and `{prefix}jaw{when}_deg`."""
        values = {f"{prefix}mpjpe_hands{when}_mm": self.mpjpe_hands_mm, f"{prefix}jaw{when}_deg": self.jaw_deg}
        return {key: None if value is None else round(value, 2) for key, value in values.items()}


def motion_errors(built: AvatarBuild, motion: Motion, truth: Motion, frames: Sequence[int]) -> tuple[float, float]:
    """MPJPE (root-aligned) and PA-MPJPE in millimetres over the 22 body joints of the given frames."""
    return joint_errors(*(joints_of(built, m, frames) for m in (motion, truth)))


def part_errors(built: AvatarBuild, motion: Motion, truth: Motion, frames: Sequence[int]) -> PartErrors:
    """Errors of hands and jaw over the given frames, where the truth moves them out of their rest pose."""
    data, frames = built.body.data, list(frames)
    names, true_poses = list(data.joint_names), check_motion_fits(truth.poses[frames], data.num_joints)
    moved = np.abs(true_poses - data.rest_pose).max((0, 2)) > 1e-4
    out = PartErrors()
    if any(moved[names.index(name)] for name in FINGERS if name in names):
        mine, theirs = (joints_of(built, m, frames) for m in (motion, truth))
        out.mpjpe_hands_mm = float(mpjpe_hands(mine, theirs, names).mean())
    if "jaw" in names and moved[names.index("jaw")]:
        jaw = names.index("jaw")
        poses = check_motion_fits(motion.poses[frames], data.num_joints)
        out.jaw_deg = float(rotation_errors(poses[:, jaw], true_poses[:, jaw]).mean())
    return out


@torch.no_grad()
def joints_of(built: AvatarBuild, motion: Motion, frames: Sequence[int]) -> np.ndarray:
    """(F, J, 3) metres, world."""
    skeleton = built.avatar.skeleton
    table = MotionTable(motion.taken(list(frames)), len(skeleton.parents))
    pose = table.to(skeleton.joints.device)()
    return (skeleton.posed_joints(pose.rotations) + pose.trans[:, None]).cpu().numpy()
