"""The names under which the SMPL family's many writers store a motion; the first of each list that is there counts."""

from __future__ import annotations

FRAME_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "mocap_fps", "fps", "frame_rate", "framerate")
WHOLE_KEYS = (
    "poses", "fullpose", "thetas", "smpl_poses", "pose", "smpl_pose", "smpl_thetas", "pred_rotmat", "pred_thetas",
    "poses_6d", "pose_6d", "smpl_poses_6d",
)  # fmt: skip
ROOT_KEYS = ("root_orient", "global_orient", "root_orient_6d", "global_orient_6d")
BODY_KEYS = ("pose_body", "body_pose", "pose_body_6d", "body_pose_6d")
JAW_KEYS = ("pose_jaw", "jaw_pose")
EYE_KEYS = ("pose_eye", ("leye_pose", "reye_pose"))
HAND_KEYS = ("pose_hand", ("left_hand_pose", "right_hand_pose"))
TRANS_KEYS = ("trans", "transl", "smpl_trans", "cam_trans", "pred_trans")
BETAS_KEYS = ("betas", "beta", "shapes", "smpl_betas", "pred_shape", "pred_betas")
EXPRESSION_KEYS = ("expression", "expressions", "expr")
PCA_KEY, FLAT_KEY = "use_pca", "flat_hand_mean"  # smplx's words for how hand poses are to be read


# Where a file says how its rotations are written
SAID_KEYS = (
    "rotation_format", "rotation_type", "rotation_representation", "rot_format", "rot_type", "rot_repr", "rotations",
    "pose_format", "pose_type", "pose_rep", "representation",
)  # fmt: skip


def flat(keys: tuple) -> tuple[str, ...]:
    """The names of a list of which some stand for pairs."""
    return tuple(k for key in keys for k in (key if isinstance(key, tuple) else (key,)))


POSE_KEYS = (*WHOLE_KEYS, *ROOT_KEYS, *BODY_KEYS)
KEYS = (
    *POSE_KEYS, *JAW_KEYS, *flat(EYE_KEYS), *flat(HAND_KEYS), *TRANS_KEYS, *BETAS_KEYS, *FRAME_RATE_KEYS,
    *EXPRESSION_KEYS, PCA_KEY, FLAT_KEY, "leg_length",
)  # fmt: skip
