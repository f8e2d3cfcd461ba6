"""Files that hold no rotations: whose they are, what they hold instead, and the way out."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import UserError
from .field_names import POSE_KEYS
from .field_reader import as_array

MDM_WAY_OUT = (
    "of Motion Diffusion Model and its kin, python -m visualize.render_mesh fits a body to them and writes "
    "..._smpl_params.npy, which is read"
)
# Names that tell what a dictionary without rotations holds
_HOLDS = (
    (("v_template", "J_regressor"), "a body model, not a motion: give a file of poses"),
    (("people", "version"), "OpenPose's keypoints of an image, not rotations: fit a body to them, with EasyMocap or "
     "SMPLify-X"),
    (("keypoints3d", "keypoints3d_optim"), "joint positions of AIST++: its folder motions/ holds the rotations"),
    (("keypoints3d",), "joint positions of EasyMocap: its folder smpl/ (or output/smpl/) holds the rotations"),
    (("pred_cam_R", "pred_cam_T"), "TRAM's camera: the persons are in hps/hps_track_0.npy beside it"),
    (("motion", "lengths"), f"positions of joints, not rotations; {MDM_WAY_OUT}"),
    (("pose_embedding",), "a code of a pose, not rotations: decode it with the model that made it"),
    (("latent_pose",), "a code of a pose, not rotations: decode it with the model that made it"),
)  # fmt: skip
_POSITIONS = ("joints3d", "joints_3d", "j3d", "joints", "keypoints", "pred_joints", "positions", "landmarks", "kp3d")


def positions_refused(path: Path, key: str, joints: int) -> UserError:
    """The error for joint positions where rotations are needed."""
    return UserError(
        f"{path}: {key} holds positions of {joints} joints, not rotations: a motion needs what turned the joints; "
        f"{MDM_WAY_OUT} (`rotations=axis-angle` takes them for rotations all the same)"
    )


def poses_missing(path: Path, names: Iterable[Any]) -> UserError:
    """The error for fields among which there are no poses."""
    return UserError(
        f"{path}: key 'poses' is missing; a motion holds poses (T, 3J), trans (T, 3) and mocap_framerate, or "
        f"root_orient and pose_body; this file holds {', '.join(sorted(map(str, names))[:40]) or 'nothing'}"
    )


def refuse_codes(path: Path, content: dict[str, Any]) -> None:
    """UserError for a pose that is a code of 32 numbers, as SMPLify-X writes it."""
    body = as_array(content.get("body_pose"))
    if body is not None and body.ndim and body.shape[-1] == 32:
        raise UserError(
            f"{path}: body_pose is VPoser's code of 32 numbers, as SMPLify-X writes it, not rotations: decode it with "
            "human_body_prior, vposer.decode(body_pose)['pose_body'], and store those 63 numbers as body_pose, or run "
            "SMPLify-X with use_vposer False"
        )


def refuse_others(path: Path, content: dict[str, Any]) -> None:
    """UserError naming what a dictionary without rotations holds, if that is known."""
    if any(key in content for key in POSE_KEYS):
        return
    for names, what in _HOLDS:
        if set(names) <= set(content):
            raise UserError(f"{path} holds {what}")
    key = next((key for key in _POSITIONS if key in content), None)
    if key is not None:
        raise UserError(
            f"{path} holds positions of joints ({key}) and no rotations: a motion needs what turned the joints; "
            "take the file in which the tool writes its poses, or fit a body to the positions"
        )
