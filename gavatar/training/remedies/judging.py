"""How an avatar looks in views that were left out and in a motion that nobody filmed: what dynamics are judged by."""

from __future__ import annotations

import copy
import functools

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.motions import MOTIONS, read_motion
from gavatar_runtime.motions.fitting import fit_motion
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

from ...attributes import Attributes
from ...images.metrics import ImageMetric, perceptual_metric
from ..motion_table import MotionTable, RowAdam
from ..scene import Scene
from ..verdicts import Look

UNFILMED_FRAMES = 12
FITTED_VIEWS, FITTING_STEPS = 12, 8
FILMED_VIEWS = 32  # whose colours are a point's filmed range
ROOM = 2 / 255  # by which a colour may leave that range
BLUR = 5  # pixels, of the box that detail is finer than


def look(scene: Scene, rows: list[int], image: float, dynamic: bool, rates: tuple[float, float]) -> Look:
    """The avatar in (some of) the views in `rows` and in a motion that nobody filmed (`unfilmed`), in images of the
    scale `image`; with the pose encoder if `dynamic`. In eval mode.

    The poses of those views were refined for one look; so each look has them fitted to it, for as many steps from where
    they are. rates: radians and metres a step at the start of that. The scene's own poses stay.
    """
    avatar = scene.avatar
    training = avatar.training
    avatar.eval()
    rows = [rows[i] for i in evenly_spaced(len(rows), FITTED_VIEWS)]
    with torch.no_grad():
        still = avatar.attributes()
        worn = [avatar.attributes(scene.pose_features(scene.frames_of([row]))) if dynamic else still for row in rows]
    poses = _fitted(scene, rows, image, worn, rates)
    errors, distances, metric = [], [], _metric()
    with torch.no_grad():
        for i, row in enumerate(rows):
            seen = scene.compare([row], image, worn[i], pose=poses(scene.frames_of([row])))
            errors.append(float((seen.render - seen.target).square().mean()))
            if metric is not None:
                distances.append(float(metric(seen.render.clamp(0, 1), seen.target)))
    detail = detail_kept(scene, image, dynamic)
    avatar.train(training)
    return Look(errors, distances or None, detail)


def _fitted(
    scene: Scene, rows: list[int], image: float, worn: list[Attributes], rates: tuple[float, float]
) -> MotionTable:
    """A copy of the scene's motion with the poses of the views in `rows` fitted to their images (mean absolute error),
    the attributes of each view as they are."""
    table = copy.deepcopy(scene.motion).requires_grad_(True)
    optimizer = RowAdam([{"params": [p]} for p in (table.rotation_correction, table.trans_correction)])
    frames = torch.tensor(sorted(set(scene.frames_of(rows))), device=scene.device)
    for step in range(FITTING_STEPS):
        optimizer.zero_grad()
        for group, rate in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = rate * (1 - step / FITTING_STEPS)
        for i, row in enumerate(rows):
            seen = scene.compare([row], image, worn[i], pose=table(scene.frames_of([row])))
            (seen.render - seen.target).abs().mean().backward()
        optimizer.step(frames)
    return table


@torch.no_grad()
def colours_beyond(scene: Scene, rows: list[int]) -> float:
    """Share of points whose colour, in a motion that nobody filmed (`unfilmed`), leaves the range that it has in (some
    of) the views in `rows`; mean over the frames."""
    avatar = scene.avatar
    training = avatar.training
    avatar.eval()
    frames = scene.frames_of([rows[i] for i in evenly_spaced(len(rows), FILMED_VIEWS)])
    filmed = torch.cat([avatar.attributes(scene.pose_features([frame])).colors for frame in frames])
    low, high = filmed.amin(0) - ROOM, filmed.amax(0) + ROOM
    shares = []
    for poses in unfilmed(scene)[0].poses:
        colors = _attributes(scene, poses, dynamic=True).colors[0]
        shares.append(float(((colors < low) | (colors > high)).any(1).float().mean()))
    avatar.train(training)
    return float(np.mean(shares))


@torch.no_grad()
def detail_kept(scene: Scene, image: float, dynamic: bool) -> float:
    """`detail_of` the avatar in a motion that nobody filmed (`unfilmed`), mean over its frames, in images of the scale
    `image`."""
    motion, cameras = unfilmed(scene)
    table = MotionTable(motion, scene.built.body.data.num_joints).to(scene.device)
    values = []
    for frame, camera in enumerate(cameras):
        attributes = _attributes(scene, motion.poses[frame], dynamic)
        values.append(detail_of(*scene.draw(attributes, table([frame]), [camera.scaled(image)])))
    return float(np.mean(values))


def unfilmed(scene: Scene) -> tuple[Motion, list[Camera]]:
    """Poses of a built-in motion of the whole body spread over it, each where the person stood and faced in one of the
    training views spread over these, and the cameras of those, of whole frames."""
    data = scene.built.body.data
    motion, _ = fit_motion(
        read_motion(MOTIONS.having(whole=True)[0]), data.joint_names, data.rest_pose, hands=data.hands
    )
    motion = motion.taken(evenly_spaced(len(motion), UNFILMED_FRAMES))
    rows = evenly_spaced(len(scene.views), UNFILMED_FRAMES)
    rows = np.resize(rows, len(motion))
    filmed = scene.motion.estimated(scene.frames_of(rows.tolist()))
    roots = filmed.rotations[:, 0].double().cpu().numpy()
    heading = np.arctan2(roots[:, 0, 2], roots[:, 2, 2])
    turns = matrix_from_axis_angle(np.stack([np.zeros_like(heading), heading, np.zeros_like(heading)], 1))
    poses, trans = motion.poses.copy(), motion.trans - motion.trans.mean(0)
    poses[:, 0] = axis_angle_from_matrix(turns @ matrix_from_axis_angle(poses[:, 0].astype(np.float64)))
    trans = (turns @ trans[..., None])[..., 0] + filmed.trans.cpu().numpy()
    cameras = [scene.footage.capture.camera(scene.views[row]) for row in rows]
    return Motion(poses.astype(np.float32), trans.astype(np.float32), motion.fps), cameras


def detail_of(images: Tensor, alpha: Tensor) -> float:
    """Mean square of what of (B, 3, H, W) images is finer than a box of `BLUR` pixels, where the whole box is on the
    person, alpha (B, H, W); 0 where it is nowhere."""
    half = BLUR // 2
    inside = -F.max_pool2d(-alpha[:, None], BLUR, 1, half) > 0.99
    fine = images - F.avg_pool2d(images, BLUR, 1, half, count_include_pad=False)
    return float((fine.square() * inside).sum() / (3 * inside.sum()).clamp(min=1))


def _attributes(scene: Scene, pose: np.ndarray, dynamic: bool) -> Attributes:
    features = scene.avatar.encode(*scene.built.encoder_tensors(pose[None])) if dynamic else None
    return scene.avatar.attributes(features)


@functools.cache
def _metric() -> ImageMetric | None:
    """The perceptual distance, None where its network is not installed."""
    try:
        return perceptual_metric()[0]
    except UserError:
        return None
