"""A capture of a person who moves fingers and jaw: the dressed free body as SMPL-X, coloured by parts and rendered."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from official_bodies import dressed_free_body, write_npz

from gavatar.avatar.atlas import sample_atlas
from gavatar.avatar.blendshapes import expression_of
from gavatar.body.official_files import FAMILIES, read_body
from gavatar_runtime.geometry.skinning import skin
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians

BETAS = np.array([0.5, -0.4])


def write_smplx_model(folder: Path):
    """SMPLX_NEUTRAL.npz in `folder`; returns its BodyData."""
    return read_body(FAMILIES["smplx"], write_npz(folder / "SMPLX_NEUTRAL.npz", dressed_free_body("smplx")))


def hand_motion(data, frames: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Poses (T, 55, 3): arms half up, fingers closing, the mouth opening; and translations (T, 3)."""
    names, phase = data.joint_names, np.linspace(0, 1, frames)
    poses = np.zeros((frames, 55, 3), np.float32)
    for side, sign in (("left", 1), ("right", -1)):
        poses[:, names.index(f"{side}_shoulder"), 2] = -0.5 * sign
        poses[:, names.index(f"{side}_elbow"), 1] = -0.3 * sign * phase
        for name in names:
            if name.startswith(f"{side}_") and name[-1].isdigit() and "thumb" not in name:
                poses[:, names.index(name), 2] = -1.2 * sign * phase
    poses[:, names.index("jaw"), 0] = 0.35 * phase
    poses[:, 0, 1] = 0.3 * (phase - 0.5)
    return poses, np.tile(np.array([0, 1.0, 0], np.float32), (frames, 1))


def part_colors(surface, data) -> np.ndarray:
    """(N, 3) one colour a joint, shaded by the normals."""
    colors = np.random.default_rng(5).uniform(0.15, 0.95, (data.num_joints, 3))
    return (colors[surface.joint_index[:, 0]] * (0.75 + 0.25 * surface.normals[:, 1:2])).astype(np.float32)


def camera(size: int, target=(0.0, 0.95, 0.0), distance: float = 4.0, fov: float = 32.0) -> Camera:
    """A camera in front of the person."""
    focal = 0.5 * size / np.tan(np.radians(fov / 2))
    world_to_camera = np.diag([1.0, -1.0, -1.0, 1.0])
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ (np.array(target) + np.array([0, 0, distance]))
    return Camera(size, size, focal, focal, size / 2, size / 2, world_to_camera)


def expressions(frames: int = 6) -> np.ndarray:
    """(T, 10) coefficients: the first two grow, the others are still."""
    phase = np.linspace(0, 1, frames)
    return np.stack([2.5 * phase, -1.5 * phase**2, *np.zeros((8, frames))], 1).astype(np.float32)


def true_gaussians(surface, data, pose: np.ndarray, trans: np.ndarray, expression=None) -> Gaussians:
    points, shift = surface.points, None
    if expression is not None:
        directions = expression_of(data, surface)
        points, shift = directions.points(points, expression), directions.joints @ expression
    means = skin(points, surface.joint_index, surface.joint_weight, surface.skin_transforms(pose, shift))
    return Gaussians(means + trans, 0.7 * surface.spacing, part_colors(surface, data))


def write_smplx_capture(folder: Path, data, size: int = 192, frames: int = 6, joints: int = 55, face=False) -> Path:
    """`frames` views of the person; with joints=52 body.npz holds the same poses in SMPL-H's order (no face); with
    `face` the expression changes too, and body.npz says so."""
    poses, trans = hand_motion(data, frames)
    surface, view = sample_atlas(data, BETAS, 256), camera(size)
    for kind in ("images", "masks"):
        (folder / kind / "cam0").mkdir(parents=True)
    rasterizer, expression = build_rasterizer(), expressions(frames) if face else None
    for t in range(frames):
        shown = true_gaussians(surface, data, poses[t], trans[t], expression[t] if face else None)
        out = rasterizer.render(shown, view, (1, 1, 1))
        pixels = np.round(np.clip(out.color, 0, 1) * 255).astype(np.uint8)
        cv2.imwrite(str(folder / "images/cam0" / f"{t:06d}.png"), pixels[..., ::-1])
        cv2.imwrite(str(folder / "masks/cam0" / f"{t:06d}.png"), np.round(out.alpha * 255).astype(np.uint8))
    written = poses if joints == 55 else np.delete(poses, slice(22, 25), 1)
    body = {"poses": written.reshape(frames, -1), "trans": trans, "betas": BETAS, "mocap_framerate": 15.0}
    np.savez(folder / "body.npz", **body, **({"expression": expression} if face else {}))
    fields = {
        "width": size, "height": size, "fx": view.fx, "fy": view.fy, "cx": view.cx, "cy": view.cy,
        "world_to_camera": view.T_camera_world.tolist(),
    }  # fmt: skip
    (folder / "cameras.json").write_text(json.dumps({"cam0": fields}))
    info = {
        "version": 1, "name": "hands", "license": "CC0-1.0", "fps": 15, "body_model": "smplx", "background": "white",
        "splits": {"train": [["cam0", list(range(frames))]]},
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(info))
    return folder
