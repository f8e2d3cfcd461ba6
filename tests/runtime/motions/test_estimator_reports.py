"""Layouts that people describe in public reports, beside those that the tools' own code writes: one a tool at least."""

from __future__ import annotations

import estimator_files as made
import numpy as np
import pytest
from motion_files import assert_same_rotations, walk
from test_estimators import write

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import quaternion_from_axis_angle
from gavatar_runtime.motions import read_motion

FRAMES = 9
TRUTH = walk(FRAMES)
POSES, TRANS, BETAS = TRUTH["poses"], TRUTH["trans"], TRUTH["betas"]
R = made.matrices(POSES)
BODY = {"global_orient": POSES[:, 0], "body_pose": made.flat(POSES[:, 1:22]), "transl": TRANS}

# report: (file, what it holds, joints that are told)
READ = {
    "zju3dv/GVHMR #10, a pickle for Blender": (
        "hmr4d_results.pt.pkl", {"smpl_params_global": {**BODY, "betas": np.tile(BETAS, (FRAMES, 1))},
                                 "smpl_params_incam": BODY}, 22,
    ),
    "TeleHuman/PBHC #9, GVHMR with six zeros more": (
        "motion.npz", {"poses": np.concatenate([made.flat(POSES[:, :22]), np.zeros((FRAMES, 6))], 1), "trans": TRANS,
                       "betas": BETAS, "gender": "neutral", "mocap_framerate": 30}, 22,
    ),
    "shubham-goel/4D-Humans #153, demo.py's output": (
        "out.pt", {"pred_cam": np.ones((FRAMES, 3)),
                   "pred_smpl_params": {"global_orient": R[:, :1], "body_pose": R[:, 1:], "betas": np.zeros((1, 10))},
                   "pred_vertices": np.zeros((FRAMES, 5, 3))}, 24,
    ),
    "shubham-goel/4D-Humans #55, one image": (
        "a.json", {"pose": POSES[0].reshape(-1).tolist(), "betas": BETAS.tolist()}, 24,
    ),
    "yufu-wang/tram #25": (
        "hps_track_0.npy", {"pred_cam": np.zeros((FRAMES, 3)), "pred_pose": np.zeros((FRAMES, 144)),
                            "pred_shape": np.zeros((FRAMES, 10)), "pred_rotmat": R, "pred_trans": TRANS,
                            "frame": np.arange(FRAMES)}, 24,
    ),
    "vye16/slahmr #57, every field": (
        "v_000100_world_results.npz", {
            "world_scale": np.ones((1, 1)), "joints_vel": np.zeros((1, 1, 22, 3)), "trans_vel": np.zeros((1, 1, 3)),
            "hand_pose": np.zeros((1, FRAMES, 90)), "latent_motion": np.zeros((1, FRAMES - 1, 48)),
            "floor_plane": np.zeros((1, 3)), "floor_idcs": np.zeros(1), "trans": TRANS[None],
            "root_orient": POSES[None, :, 0], "betas": np.zeros((1, 16)), "latent_pose": np.zeros((1, 1, 32)),
            "root_orient_vel": np.zeros((1, 1, 3)), "pose_body": made.flat(POSES[:, 1:22])[None],
            "cam_R": np.zeros((1, FRAMES, 3, 3)), "cam_t": np.zeros((1, FRAMES, 3)), "intrins": np.zeros(4),
            "pose_hand": np.zeros((1, FRAMES, 90)), "track_mask": np.ones((1, FRAMES), bool)}, 22,
    ),
    "Arthur151/ROMP #36, 3DPW of one actor": (
        "outdoors.pkl", {"poses": [made.flat(POSES)], "trans": [TRANS], "betas": [BETAS], "betas_clothed": [BETAS],
                         "poses_60Hz": [np.repeat(made.flat(POSES), 2, 0)], "trans_60Hz": [np.repeat(TRANS, 2, 0)],
                         "campose_valid": [np.ones(FRAMES)], "cam_poses": np.zeros((FRAMES, 4, 4)),
                         "poses2d": [np.zeros((FRAMES, 3, 18))], "genders": ["m"], "sequence": "outdoors"}, 24,
    ),
    "apple/ml-neuman #77, ROMP of one frame": (
        "00000.npz", {"cam": np.ones((1, 3)), "global_orient": POSES[:1, 0], "body_pose": made.flat(POSES[:1, 1:]),
                      "smpl_betas": BETAS[None], "smpl_thetas": made.flat(POSES[:1])}, 24,
    ),
    "vchoutas/smplx #133, transfer_model": (
        "00.pkl", {"global_orient": R[:1, :1], "body_pose": R[:1, 1:22], "transl": TRANS[:1], "betas": BETAS[None],
                   "left_hand_pose": np.tile(np.eye(3), (1, 15, 1, 1)), "jaw_pose": np.eye(3)[None, None],
                   "right_hand_pose": np.tile(np.eye(3), (1, 15, 1, 1)), "leye_pose": np.eye(3)[None, None],
                   "reye_pose": np.eye(3)[None, None], "expression": np.zeros((1, 10)),
                   "full_pose": np.tile(np.eye(3), (1, 55, 1, 1)), "faces": np.zeros((5, 3), int)}, 22,
    ),
    "zju3dv/EasyMocap #437, 69 numbers": (
        "000000.json", [{"id": 0, "Rh": POSES[:1, 0].tolist(), "Th": TRANS[:1].tolist(),
                         "poses": made.flat(POSES[:1, 1:]).tolist(), "shapes": BETAS[None].tolist()}], 24,
    ),
    "google/aistplusplus_api #14, scaling as a number": (
        "gBR.pkl", {"smpl_poses": made.flat(POSES), "smpl_trans": TRANS * 93.5, "smpl_scaling": 93.5}, 24,
    ),
    "mkocabas/VIBE #65, a track called -1": (
        "vibe_output.pkl", {-1: {"pred_cam": np.ones((FRAMES, 3)), "orig_cam": np.ones((FRAMES, 4)),
                                 "pose": made.flat(POSES), "betas": np.zeros((FRAMES, 10)),
                                 "frame_ids": np.arange(FRAMES)}}, 24,
    ),
    "li-ronghui/FineDance #22, taken apart": (
        "a.npz", {"poses_6d": np.concatenate([R[..., 0], R[..., 1]], -1).reshape(FRAMES, -1), "trans": TRANS}, 24,
    ),
    "smplx #133 with quaternions, the file says wxyz": (
        "a.npz", {"poses": quaternion_from_axis_angle(POSES.astype(float)), "rotation_type": "wxyz"}, 24,
    ),
}  # fmt: skip


@pytest.mark.parametrize("report", READ)
def test_what_reports_describe_is_read_as_it_was_stored(tmp_path, report):
    name, content, joints = READ[report]
    motion = read_motion(write(tmp_path / name, content), up="y")
    assert len(motion) in (1, FRAMES)
    assert_same_rotations(motion, POSES[: len(motion)], joints)
    if motion.trans.any():
        np.testing.assert_allclose(motion.trans - motion.trans[0], (TRANS - TRANS[0])[: len(motion)], atol=1e-4)


def test_a_pelvis_that_pymaf_x_puts_first_is_the_pelvis(tmp_path):
    """Skype-line/X-Avatar #9: one dictionary a frame, body_pose (1, 22, 3, 3) or with hands, no global_orient."""
    frames = {
        0: {"smplx_params": [{"body_pose": M[None, :22], "jaw_pose": np.eye(3)[None], "shape": BETAS[None],
                              "expression": np.zeros((1, 50))} for M in R], "frame_ids": np.arange(FRAMES)}
    }  # fmt: skip
    assert_same_rotations(read_motion(write(tmp_path / "output.pkl", frames), up="y"), POSES, 22)


def test_a_folder_of_a_file_a_frame_is_one_motion(tmp_path):
    """Arthur151/ROMP #240: BEV writes every frame's .npz alone."""
    folder = tmp_path / "results"
    folder.mkdir()
    for t in range(FRAMES):
        frame = {"smpl_thetas": made.flat(POSES[t : t + 1]), "cam_trans": TRANS[t : t + 1], "smpl_betas": BETAS[None]}
        np.savez(folder / f"{t:08d}.npz", results=np.array(frame, object))
    motion = read_motion(folder, up="y")
    assert_same_rotations(motion, POSES)


REFUSED = {
    "softcat477/SMPL-to-FBX #2, AIST++'s keypoints": (
        "a.pkl", {"keypoints3d": np.zeros((5, 17, 3)), "keypoints3d_optim": np.zeros((5, 17, 3))}, "AIST.*motions/",
    ),
    "IsshikiHugh/HSMR #13, SKEL": ("a.npz", {"poses": np.ones((5, 46)), "betas": np.zeros((5, 10))}, "SKEL.*HSMR"),
    "li-ronghui/FineDance #22, 315 numbers": ("a.npy", np.zeros((5, 315)), "6D.*FineDance"),
    "liangxuy/ReGenNet #2, 56 x 3": ("a.npy", np.zeros((5, 56, 3)), "55 joints and 3 numbers of a place"),
    "GuyTevet/motion-diffusion-model #5": (
        "results.npy", {"motion": np.zeros((3, 22, 3, 12)), "text": ["a"], "lengths": np.array([12]), "num_samples": 1},
        "Motion Diffusion Model",
    ),
    "harmony4d #12, vertices alone": ("a.npz", {"vertices": np.zeros((2, 6890, 3))}, "no body has so many joints"),
}  # fmt: skip


@pytest.mark.parametrize("report", REFUSED)
def test_what_holds_no_rotations_is_refused_by_its_name(tmp_path, report):
    name, content, words = REFUSED[report]
    with pytest.raises(UserError, match=words) as raised:
        read_motion(write(tmp_path / name, content))
    assert "\n" not in str(raised.value)


def test_the_dance_clips_of_motion_x_come_in_another_unit_and_it_is_said(tmp_path):
    """IDEA-Research/Motion-X #10: the clips of AIST had unscaled translations."""
    numbers = made.motion_x({**TRUTH, "trans": TRANS * 95})
    motion = read_motion(write(tmp_path / "a.npy", numbers), up="y")
    assert any("taken for cm" in note and "`units=m`" in note for note in motion.notes)
