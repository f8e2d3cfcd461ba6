"""Where to put the camera: far enough to hold the whole motion, facing the person."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ..avatar.played import PlayedAvatar
from ..geometry.rotations import matrix_from_axis_angle
from ..geometry.skinning import skin
from ..geometry.spacing import evenly_spaced
from ..splatting_rule import NEAR
from ..values.camera import Camera, look_at
from ..values.motion import Motion

FOCAL = 50 / 36  # of the longer image side: a 50 mm lens on 36 mm film, which keeps a person's proportions
MARGIN = 0.06  # of each image side, left free on either edge: hair and loose clothes leave the body's surface
SAMPLED_FRAMES, SAMPLED_POINTS = 60, 400
DIRECTIONS = {"front": 0.0, "left": 90.0, "back": 180.0, "right": 270.0}  # degrees about the vertical


def frame_motion(
    avatar: PlayedAvatar, motion: Motion, width: int, height: int, *, azimuth: float = 0.0, orbit: bool = False,
    beside: Sequence[tuple[PlayedAvatar, Motion]] = (),
) -> Camera:  # fmt: skip
    """A level camera that holds the avatar throughout a motion.

    motion: fitted to the avatar. azimuth: degrees from the person's front at the first frame towards their left side.
    orbit: hold it from every side, for a camera that will circle. beside: other avatars to hold, each with its motion.
    """
    points = points_of_all([(avatar, motion), *beside])
    target = (points.min(0) + points.max(0)) / 2
    start = facing(motion) + np.radians(azimuth)
    angles = start + np.linspace(0, 2 * np.pi, 36, endpoint=False) if orbit else np.array([start])
    focal = FOCAL * max(width, height)
    half = (0.5 - MARGIN) * np.array([width, height])
    # seen level along each angle: right, up and forwards (towards the camera), relative to the target
    offset = points - target
    right = np.outer(np.cos(angles), offset[:, 0]) - np.outer(np.sin(angles), offset[:, 2])
    toward = np.outer(np.sin(angles), offset[:, 0]) + np.outer(np.cos(angles), offset[:, 2])
    needed = np.maximum(np.abs(right) / half[0], np.abs(offset[:, 1]) / half[1])
    distance = max(float(np.max(toward + focal * needed)), float(np.max(toward)) + 0.5)
    eye = target + distance * np.array([np.sin(start), 0, np.cos(start)])
    return Camera(width, height, focal, focal, width / 2, height / 2, look_at(eye, target))


def orbit(camera: Camera, target: np.ndarray, turns: np.ndarray) -> list[Camera]:
    """The camera carried about the vertical through `target` (3,), once for each of `turns` (fractions of a circle,
    counterclockwise seen from above)."""
    cameras = []
    for angle in 2 * np.pi * np.asarray(turns, np.float64):
        R = matrix_from_axis_angle(np.array([0, -angle, 0]))
        T = np.eye(4)
        T[:3, :3] = R
        T[:3, 3] = target - R @ target
        cameras.append(dataclasses.replace(camera, T_camera_world=camera.T_camera_world @ T))
    return cameras


def fitted_to(camera: Camera, width: int, height: int) -> Camera:
    """The view of `camera` on another image size, whole and centred, with square pixels kept square."""
    factor = min(width / camera.width, height / camera.height)
    dx, dy = (width - factor * camera.width) / 2, (height - factor * camera.height) / 2
    return Camera(
        width, height, camera.fx * factor, camera.fy * factor, camera.cx * factor + dx, camera.cy * factor + dy,
        camera.T_camera_world,
    )  # fmt: skip


def points_of_all(all_played: Sequence[tuple[PlayedAvatar, Motion]]) -> np.ndarray:
    """(S, 3) the `body_points` of several."""
    return np.concatenate([body_points(avatar, motion) for avatar, motion in all_played])


def body_points(avatar: PlayedAvatar, motion: Motion) -> np.ndarray:
    """(S, 3) a sample of the body's surface over the whole motion, world, metres."""
    return np.concatenate(list(posed_samples(avatar, motion, _sampled_frames(motion), SAMPLED_POINTS)))


def posed_samples(avatar: PlayedAvatar, motion: Motion, frames: Iterable[int], count: int) -> Iterator[np.ndarray]:
    """(S, 3) metres, world, for each of `frames`: every so many points of the body's surface, that `count` of
    them are asked for and S is up to twice as many."""
    surface = avatar.surface
    step = max(1, len(surface) // count)
    points, index, weight = (
        np.ascontiguousarray(a[::step]) for a in (surface.points, surface.joint_index, surface.joint_weight)
    )
    for frame in frames:
        A = surface.skin_transforms(motion.poses[frame].astype(np.float32))
        yield skin(points, index, weight, A) + motion.trans[frame]


def facing(motion: Motion) -> float:
    """Radians about the vertical from +z to where the pelvis faces at the first frame; 0 if it faces up or down."""
    forward = matrix_from_axis_angle(motion.poses[0, 0].astype(np.float64))[:, 2]
    return float(np.arctan2(forward[0], forward[2])) if np.hypot(forward[0], forward[2]) > 0.2 else 0.0


def size_on_screen(avatar: PlayedAvatar, motion: Motion, cameras: Sequence[Camera]) -> float:
    """Pixels that the person upright would be tall at the frame where a camera is nearest to them; infinite where a
    camera is within the body. motion: fitted to the avatar. cameras: one a frame."""
    frames = _sampled_frames(motion)
    points = body_points(avatar, motion).reshape(len(frames), -1, 3)
    height = float(np.ptp(avatar.surface.points[:, 1]))
    largest = 0.0
    for frame, posed in zip(frames, points, strict=True):
        camera = cameras[frame]
        depth = (posed @ camera.T_camera_world[2, :3] + camera.T_camera_world[2, 3]).min()
        if not depth > NEAR:
            return np.inf
        largest = max(largest, height * max(camera.fx, camera.fy) / depth)
    return largest


def _sampled_frames(motion: Motion) -> np.ndarray:
    return evenly_spaced(len(motion), SAMPLED_FRAMES)
