"""What the training views say of each point: how much of them it makes up, how squarely, in which poses, from where."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gavatar_runtime.geometry.rotations import matrix_from_axis_angle
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion
from gavatar_runtime.values.point_evidence import Evidence
from gavatar_runtime.values.surface import Surface

from ...attributes import Attributes
from ...images.pixel_weights import pixel_weights
from ..scene import Scene
from .facing import squareness
from .placed_evidence import PlacedEvidence

ASLANT, SQUARE = 0.15, 0.5  # cosine up to which a view says nothing of a point, and from which on it says all it can
DIRECTIONS = 48  # of a sphere, some 30 degrees apart
ANOTHER_POSE = np.radians(25)  # that one of the joints about a point turns, from which on its pose is another one
AWAY = 0.1  # what a pixel counts of a point that faces away: hair is seen past the neck that it hangs behind
WHOLE = 0.4, 0.8  # of a view's worth, that such a point must show: less is what shines through gaps before it
BURIED = 0.5  # what a point counts that its neighbours cover, of what is seen of them: it is as training wants it
NEIGHBOURS = 13  # itself among them
A_LOOK = 0.1  # of a view's worth, from which on a view counts for the number of poses and of directions


def view_weights(scene: Scene, row: int, scale: float, attributes: Attributes | None = None) -> Tensor:
    """(N,) pixels of the person in the view `row`, at an image scale, that each point of the avatar makes up.

    The avatar is the static one, in the poses that it has now. attributes: as decoded before, if they were.
    """
    footage = scene.footage.at(scale)
    with torch.no_grad():
        (gaussians,) = scene.gaussians(attributes or scene.avatar.attributes(), scene.motion(scene.frames_of([row])))
    _, mask = footage.batch([row], torch.zeros(3), scene.device)
    return pixel_weights(scene.rasterize, gaussians, footage.cameras[row], mask[0])


def ramp(cosine: np.ndarray) -> np.ndarray:
    """What a pixel counts of a point that is seen under this cosine between normal and view, 0 to 1."""
    return np.clip((cosine - ASLANT) / (SQUARE - ASLANT), 0, 1)


def _about(surface: Surface, values: np.ndarray) -> np.ndarray:
    """(N,) median of values (N,) over the nearest points of the same side of the body."""
    index = cKDTree(surface.points).query(surface.points, min(NEIGHBOURS, len(surface)))[1].reshape(len(surface), -1)
    same = np.einsum("nkj,nj->nk", surface.normals[index], surface.normals) > 0
    return np.nan_to_num(np.nanmedian(np.where(same, values[index], np.nan), axis=1))


def _past(share: np.ndarray) -> np.ndarray:
    """How surely a point that faces away is itself what is seen, by the share of a view's worth that it shows."""
    return np.clip((share - WHOLE[0]) / (WHOLE[1] - WHOLE[0]), 0, 1)


def evidence_of(scene: Scene, scale: float) -> PlacedEvidence:
    """What all views of a scene say of each point of its avatar, at an image scale, in the poses that it has now."""
    surface, motion, cameras = scene.avatar.surface, scene.motion.motion(), scene.footage.at(scale).cameras
    with torch.no_grad():
        attributes = scene.avatar.attributes()
    count, area = len(surface), np.maximum(surface.spacing.astype(np.float64), 1e-9) ** 2
    labels = pose_labels(surface, motion)
    near = labels[surface.joint_index[:, 0]]  # (N, F) the pose of the joints about each point
    in_pose, from_side = np.zeros((count, near.max(initial=0) + 1), bool), np.zeros((count, DIRECTIONS), bool)
    pixels, views, cosines, all_pixels = (np.zeros(count) for _ in range(4))
    for row, frame in enumerate(scene.frames_of(range(len(scene.views)))):
        weight = view_weights(scene, row, scale, attributes).cpu().numpy().astype(np.float64)
        weight = np.where(np.isfinite(weight), np.maximum(weight, 0), 0)
        cosine, towards = squareness(surface, motion, frame, cameras[row])
        worth = _pixel(cameras[row], motion, frame, surface) ** 2 / area  # of a pixel, in views of the whole point
        square = ramp(cosine)
        counted = weight * (square + AWAY * (1 - square) * _past(weight * worth))
        share = weight * square * worth
        pixels, views = pixels + counted, views + counted * worth
        cosines, all_pixels = cosines + weight * np.maximum(cosine, 0), all_pixels + weight
        looked = np.flatnonzero(share > A_LOOK)
        in_pose[looked, near[looked, frame]] = True
        from_side[looked, (towards[looked] @ sphere(DIRECTIONS).T).argmax(1)] = True
    views = np.maximum(views, BURIED * _about(surface, views))
    mean = cosines / np.maximum(all_pixels, 1e-9)
    evidence = Evidence(
        pixels.astype(np.float32),
        views.astype(np.float32),
        np.clip(mean, 0, 1).astype(np.float32),
        in_pose.sum(1).astype(np.int32),
        from_side.sum(1).astype(np.int32),
    )
    return PlacedEvidence(np.asarray(surface.points, np.float32), evidence)


def _pixel(camera: Camera, motion: Motion, frame: int, surface: Surface) -> float:
    """Metres that a pixel spans at the person's place."""
    place = motion.trans[frame] + surface.joints[surface.root]
    depth = float(camera.T_camera_world[2, :3] @ place + camera.T_camera_world[2, 3])
    return max(depth, 0.0) * 2 / (camera.fx + camera.fy)


def sphere(count: int) -> np.ndarray:
    """(count, 3) directions spread evenly (a Fibonacci lattice)."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], -1)


def pose_labels(surface: Surface, motion: Motion) -> np.ndarray:
    """(J, F) int: for each joint, which of the poses of itself, its parent and its children a frame has. A frame whose
    joints there all lie within 25 degrees of an earlier pose is in that one. The root's own turn is none."""
    rotations = matrix_from_axis_angle(np.asarray(motion.poses, np.float64))
    parents, (frames, count) = surface.parents, rotations.shape[:2]
    out = np.zeros((count, frames), int)
    for joint in range(count):
        about = [j for j in range(count) if joint in (j, parents[j]) or j == parents[joint]]
        near = rotations[:, [j for j in about if parents[j] >= 0]]
        leaders: list[int] = []
        for frame in range(frames):
            trace = np.einsum("ljab,jab->lj", near[leaders], near[frame])
            angle = np.arccos(np.clip((trace - 1) / 2, -1, 1)).max(1, initial=0)
            if not len(angle) or angle.min() > ANOTHER_POSE:
                leaders.append(frame)
                out[joint, frame] = len(leaders) - 1
            else:
                out[joint, frame] = angle.argmin()
    return out
