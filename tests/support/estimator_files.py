"""What pose estimators store, made of one motion: poses (T, 24, 3), trans (T, 3), betas (10,), as `motion_files.walk`
has them. Layouts after each tool's own code."""

from __future__ import annotations

import collections
from typing import Any

import numpy as np

from gavatar_runtime.geometry.rotations import matrix_from_axis_angle

Walk = dict[str, np.ndarray]


def matrices(poses: np.ndarray) -> np.ndarray:
    return matrix_from_axis_angle(poses.astype(np.float64)).astype(np.float32)


def flat(poses: np.ndarray) -> np.ndarray:
    return poses.reshape(len(poses), -1)


def gvhmr(walk: Walk) -> dict[str, Any]:
    world = {
        "global_orient": walk["poses"][:, 0], "body_pose": flat(walk["poses"][:, 1:22]), "transl": walk["trans"],
        "betas": np.tile(walk["betas"], (len(walk["poses"]), 1)),
    }  # fmt: skip
    camera = {**world, "global_orient": -world["global_orient"], "transl": world["transl"] + 3}
    return {"smpl_params_global": world, "smpl_params_incam": camera, "K_fullimg": np.eye(3)[None]}


def wham(*walks: Walk) -> collections.defaultdict:
    people: collections.defaultdict = collections.defaultdict(dict)
    for number, walk in enumerate(walks):
        T = len(walk["poses"])
        people[3 * number] = {
            "pose": np.zeros((T, 72)), "trans": np.zeros((T, 3)), "pose_world": flat(walk["poses"]),
            "trans_world": walk["trans"], "betas": np.tile(walk["betas"], (T, 1)), "verts": np.zeros((T, 5, 3)),
            "frame_ids": np.arange(T) + 10,
        }  # fmt: skip
    return people


def vibe(walk: Walk) -> dict[int, dict[str, Any]]:
    T = len(walk["poses"])
    return {
        1: {
            "pred_cam": np.ones((T, 3)), "orig_cam": np.ones((T, 4)), "verts": np.zeros((T, 5, 3)),
            "pose": flat(walk["poses"]), "betas": np.tile(walk["betas"], (T, 1)), "joints3d": np.zeros((T, 49, 3)),
            "joints2d": None, "bboxes": np.zeros((T, 4)), "frame_ids": np.arange(T),
        }
    }  # fmt: skip


def phalp(walk: Walk, *, unseen: tuple[int, ...] = (), other: Walk | None = None) -> dict[str, dict[str, Any]]:
    """A dictionary a frame, not in order; in the frames `unseen` the tracker only guesses, and says so. other: a second
    person, listed first."""
    frames = {}
    for t, R in enumerate(matrices(walk["poses"])):
        bodies = [(7, R, int(t in unseen))]
        if other is not None and t < len(other["poses"]):
            bodies.insert(0, (2, matrices(other["poses"][t]), 0))
        frames[f"outputs//_DEMO/clip/img/{t}.jpg"] = {
            "time": t, "shot": 0, "tid": [i for i, _, _ in bodies], "tracked_time": [age for _, _, age in bodies],
            "smpl": [
                {"global_orient": M[:1] if not age else np.eye(3)[None], "body_pose": M[1:], "betas": walk["betas"]}
                for _, M, age in bodies
            ],
            "camera": [np.array([0.1, 0.2, 139.0])] * len(bodies), "conf": [np.float64(0.9)] * len(bodies),
        }  # fmt: skip
    return dict(sorted(frames.items()))  # 10.jpg before 2.jpg


def tram(walk: Walk) -> dict[str, Any]:
    T = len(walk["poses"])
    return {
        "pred_cam": np.zeros((T, 3)), "pred_pose": np.zeros((T, 144)), "pred_shape": np.tile(walk["betas"], (T, 1)),
        "pred_rotmat": matrices(walk["poses"]), "pred_trans": walk["trans"][:, None], "frame": np.arange(T),
    }  # fmt: skip


def slahmr(*walks: Walk) -> dict[str, Any]:
    """Persons of unequal length in one array, the rest masked out."""
    T = max(len(walk["poses"]) for walk in walks)

    def rows(arrays: list[np.ndarray]) -> np.ndarray:
        return np.stack([np.concatenate([a, np.full((T - len(a), *a.shape[1:]), 0.5)]) for a in arrays])

    return {
        "trans": rows([w["trans"] for w in walks]), "root_orient": rows([w["poses"][:, 0] for w in walks]),
        "pose_body": rows([flat(w["poses"][:, 1:22]) for w in walks]), "betas": np.zeros((len(walks), 16)),
        "track_mask": rows([np.ones(len(w["poses"])) for w in walks]) == 1, "floor_plane": np.zeros((len(walks), 3)),
        "cam_R": np.zeros((len(walks), T, 3, 3)),
    }  # fmt: skip


def three_dpw(*walks: Walk) -> dict[str, Any]:
    return {
        "sequence": "s", "poses": [flat(w["poses"]) for w in walks], "trans": [w["trans"] for w in walks],
        "betas": [w["betas"] for w in walks], "genders": ["m"] * len(walks), "cam_poses": np.zeros((5, 4, 4)),
        "poses_60Hz": [np.repeat(flat(w["poses"]), 2, 0) for w in walks], "jointPositions": [np.zeros((5, 72))],
    }  # fmt: skip


def romp_frames(*walks: Walk, tracked: bool = True) -> dict[str, Any]:
    frames = {}
    for t in range(max(len(w["poses"]) for w in walks)):
        here = [(i, w) for i, w in enumerate(walks) if t < len(w["poses"])]
        frames[f"{t:08d}.jpg"] = {
            "smpl_thetas": np.stack([flat(w["poses"])[t] for _, w in here]),
            "cam_trans": np.stack([w["trans"][t] for _, w in here]), "cam": np.ones((len(here), 3)),
            "smpl_betas": np.stack([w["betas"] for _, w in here]),
        } | ({"track_ids": np.array([5 + i for i, _ in here])} if tracked else {})  # fmt: skip
    return {"results": np.array(frames, object)}


def romp_sequences(*walks: Walk) -> dict[str, Any]:
    people = {
        5 + i: {
            "frame_id": list(range(len(w["poses"]))), "smpl_thetas": list(flat(w["poses"])),
            "cam_trans": list(w["trans"]), "smpl_betas": [w["betas"]] * len(w["poses"]),
        }
        for i, w in enumerate(walks)
    }  # fmt: skip
    return romp_frames(*walks) | {"sequence_results": np.array(people, object)}


def pymaf_x(walk: Walk, batches: int = 2) -> dict[int, dict[str, Any]]:
    R, T = matrices(walk["poses"]), len(walk["poses"])
    parts = [
        {
            "shape": np.tile(walk["betas"], (len(rows), 1)), "body_pose": R[rows, :22],
            "left_hand_pose": np.tile(np.eye(3), (len(rows), 15, 1, 1)),
            "right_hand_pose": np.tile(np.eye(3), (len(rows), 15, 1, 1)),
            "jaw_pose": np.tile(np.eye(3), (len(rows), 1, 1, 1)), "leye_pose": np.tile(np.eye(3), (len(rows), 1, 1, 1)),
            "reye_pose": np.tile(np.eye(3), (len(rows), 1, 1, 1)), "expression": np.zeros((len(rows), 10)),
        }
        for rows in np.array_split(np.arange(T), batches)
    ]  # fmt: skip
    return {0: {"pred_cam": np.ones((T, 3)), "smplx_params": parts, "frame_ids": np.arange(T)}}


def motion_x(walk: Walk) -> np.ndarray:
    T = len(walk["poses"])
    out = np.zeros((T, 322), np.float32)
    out[:, :66], out[:, 309:312], out[:, 312:] = flat(walk["poses"][:, :22]), walk["trans"], walk["betas"]
    return out


def mdm(walk: Walk) -> dict[str, Any]:
    """Of Motion Diffusion Model: the first two rows of matrices, the frames last."""
    rows = matrices(walk["poses"])[..., :2, :].reshape(len(walk["poses"]), 24, 6)
    return {
        "motion": np.zeros((25, 6, len(rows))), "thetas": np.moveaxis(rows, 0, -1), "root_translation": walk["trans"].T,
        "text": "a person walks", "length": len(rows), "vertices": np.zeros((5, 3, len(rows))),
    }  # fmt: skip


def easymocap(walk: Walk, t: int, label: int = 0) -> dict[str, Any]:
    """One person of a frame, as JSON has it: Rh turns about the model's origin."""
    pelvis = np.array([0, -0.23, 0.03])  # of the mean SMPL body, which the reader assumes too
    R = matrices(walk["poses"][t, 0]).astype(np.float64)
    poses = np.concatenate([np.zeros(3), walk["poses"][t, 1:].reshape(-1)])
    return {
        "id": label, "Rh": [walk["poses"][t, 0].tolist()], "Th": [(walk["trans"][t] + pelvis - R @ pelvis).tolist()],
        "poses": [poses.tolist()], "shapes": [walk["betas"].tolist()],
    }  # fmt: skip


def smplify_x(walk: Walk, t: int) -> dict[str, Any]:
    return {
        "camera_rotation": np.eye(3)[None], "camera_translation": np.array([[0, 0, 30.0]]), "betas": np.zeros((1, 10)),
        "global_orient": walk["poses"][t, :1], "body_pose": walk["poses"][t, 1:22].reshape(1, 63),
        "left_hand_pose": np.zeros((1, 12)), "right_hand_pose": np.zeros((1, 12)), "jaw_pose": np.zeros((1, 3)),
        "leye_pose": np.zeros((1, 3)), "reye_pose": np.zeros((1, 3)), "expression": np.zeros((1, 10)),
    }  # fmt: skip


def aist(walk: Walk) -> dict[str, Any]:
    return {
        "smpl_poses": flat(walk["poses"]), "smpl_trans": walk["trans"] * 88.0, "smpl_scaling": np.array([88.0]),
        "smpl_loss": 1.5,
    }  # fmt: skip
