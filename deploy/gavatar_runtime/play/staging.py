"""What `gavatar-play` plays: the avatar, the motion and the cameras that its arguments ask for."""

from __future__ import annotations

import argparse

import numpy as np

from ..avatar.adaptive import AdaptiveAvatar
from ..avatar.playing import Avatar
from ..bundle import Bundle
from ..cli.play_arguments import AUTO, DEFAULT_FPS, DEFAULT_SIZE
from ..cli.settings import parse_value
from ..decoding.detail import WORTH, uv_for_size
from ..errors import UserError, did_you_mean
from ..formats.camera_file import read_camera
from ..tiers import player_tiers
from ..values.camera import Camera
from ..values.motion import Motion
from .framing import DIRECTIONS, body_points, fitted_to, frame_motion, orbit, size_on_screen
from .grounding import grounded


def open_avatar(bundle: Bundle, tier: str, motion: Motion, arguments: argparse.Namespace) -> Avatar:
    """The avatar at the level of detail that is asked for, or one that adapts it."""
    if arguments.budget_ms:
        if arguments.uv or arguments.reuse > 1 or arguments.seen_only:
            raise UserError(
                "--budget-ms chooses the level of detail and the reuse: leave --uv, --reuse and --seen-only out"
            )
        return AdaptiveAvatar(bundle, arguments.budget_ms / 1000, tier=tier, threads=arguments.threads)
    uv = _uv_on_screen(bundle, motion, arguments) if arguments.uv == AUTO else arguments.uv
    how = {"tier": tier, "reuse": arguments.reuse, "seen_only": arguments.seen_only, "threads": arguments.threads}
    avatar = Avatar(bundle, uv=uv, **how)
    if arguments.seen_only and not avatar.seen_only:
        raise UserError(f"--seen-only: {_why_not_seen_only(avatar, arguments.reuse)}")
    return avatar


def _uv_on_screen(bundle: Bundle, motion: Motion, arguments: argparse.Namespace) -> int | None:
    """The level of detail that the person's largest size in the images is worth."""
    body = Avatar(bundle, tier=None)
    motion, _, cameras = staged(body, motion, arguments)
    uv = uv_for_size(body.surface, size_on_screen(body, motion, cameras))
    return uv if uv < WORTH * body.surface.resolution else None


def _why_not_seen_only(avatar: Avatar, reuse: int) -> str:
    if reuse > 1:
        return "decodes that are reused are of all Gaussians: leave --reuse out"
    if player_tiers()[avatar.tier].factory.picks and avatar.dynamic:
        return f"{avatar.bundle.path} was written before that was possible: export it again"
    return f"tier {avatar.tier} has nothing to leave out: it is for --tier full and int8 of an avatar with dynamics"


def staged(
    avatar: Avatar, motion: Motion, arguments: argparse.Namespace
) -> tuple[Motion, tuple[str, ...], list[Camera]]:
    """The motion fitted to the avatar, on the floor if asked, what of it the body lacks, and one camera a frame."""
    motion, ignored = avatar.fit(motion)
    if arguments.ground:
        motion, _ = grounded(avatar, motion)
    return motion, ignored, choose_cameras(arguments, avatar, motion)


def clip(motion: Motion, fps: float | None, seconds: float | None, frames: slice | None) -> Motion:
    """The part of a motion that is played: resampled, then repeated or cut to `seconds`, then `frames` of that.

    fps: None keeps the motion's own up to 30. Raises UserError when no frame is left.
    """
    fps = fps or min(motion.fps, DEFAULT_FPS)
    motion = motion.resampled(fps)
    index = np.arange(len(motion))
    if seconds is not None:
        index = np.arange(max(1, round(seconds * fps))) % len(motion)
    if frames is not None:
        count, index = len(index), index[frames]
        if not len(index):
            raise UserError(
                f"--frames leaves no frame: motion '{motion.name}' has {count} at {fps:g} frames per second"
            )
    return motion.taken(index)


def choose_cameras(arguments: argparse.Namespace, avatar: Avatar, motion: Motion) -> list[Camera]:
    """One camera a frame, from --camera, --orbit and the size options."""
    asked = arguments.size or arguments.width or arguments.height
    width = arguments.width or arguments.size or arguments.height or DEFAULT_SIZE
    height = arguments.height or arguments.size or arguments.width or DEFAULT_SIZE
    if ".json" in arguments.camera.lower():
        camera = read_camera(arguments.camera)
        if asked:
            camera = fitted_to(camera, width, height)
    else:
        azimuth = _azimuth(arguments.camera)
        camera = frame_motion(avatar, motion, width, height, azimuth=azimuth, orbit=arguments.orbit is not None)
    if arguments.orbit is None:
        return [camera] * len(motion)
    points = body_points(avatar, motion)
    period = arguments.orbit * motion.fps or len(motion)
    return orbit(camera, (points.min(0) + points.max(0)) / 2, np.arange(len(motion)) / period)


def _azimuth(text: str) -> float:
    if text in DIRECTIONS:
        return DIRECTIONS[text]
    value = parse_value(text)
    if isinstance(value, (int, float)) and abs(value) <= 1e6:
        return float(value)
    raise UserError(f"unknown camera '{text}': give degrees, FILE.json[:NAME], or {did_you_mean(text, DIRECTIONS)}")
