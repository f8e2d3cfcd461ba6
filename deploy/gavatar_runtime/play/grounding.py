"""Putting a motion on the floor."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..avatar.played import PlayedAvatar
from ..values.motion import Motion
from .framing import posed_samples

POINTS = 5000  # of the surface that are asked for their height: two centimetres apart on a person
STANDING = 0.05  # share of the frames whose lowest point may lie below the floor: a foot that slips into it


def lowest_points(avatar: PlayedAvatar, motion: Motion) -> np.ndarray:
    """(T,) metres, the height of the body's lowest point at each frame. motion: fitted to the avatar."""
    return np.array([float(p[:, 1].min()) for p in posed_samples(avatar, motion, range(len(motion)), POINTS)])


def grounded(avatar: PlayedAvatar, motion: Motion) -> tuple[Motion, float]:
    """The motion moved up or down as a whole so that the avatar stands on y = 0, and the metres that it was moved up.

    The floor is where the lowest point is in the lowest twentieth of the frames, so that jumps stay jumps.
    """
    lift = -float(np.quantile(lowest_points(avatar, motion), STANDING))
    trans = motion.trans + np.array([0, lift, 0], motion.trans.dtype)
    return dataclasses.replace(motion, trans=trans), lift
