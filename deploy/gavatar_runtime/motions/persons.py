"""Which person of a file is taken, and the frames in which that person was not seen."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ..errors import UserError, did_you_mean, frames_named
from ..geometry.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle, slerp
from ..values.motion import Motion
from .estimators import Person

_MOST_FILLED = 100  # times as many frames as were seen: more, and the numbers are no frames of one video


def choose_person(path: Path, people: list[Person], wanted: str) -> tuple[Person, list[str]]:
    """The person of that label, or the one with most frames, and a note that names the others.

    UserError listing the labels for another one.
    """
    if wanted:
        chosen = next((person for person in people if person.label == wanted), None)
        if chosen is None:
            labels = [person.label for person in people if person.label]
            if not labels:
                raise UserError(f"{path} holds one person: leave `person={wanted}` out")
            raise UserError(f"{path} has no person '{wanted}': {did_you_mean(wanted, labels)}")
        return chosen, []
    longest = max(people, key=len)
    others = [person for person in people if person is not longest]
    if not others:
        return longest, []
    named = ", ".join(f"{person.label} ({len(person)} frames)" for person in others[:10])
    named += f" and {len(others) - 10} more" if len(others) > 10 else ""
    return longest, [
        f"{len(people)} persons: {longest.label} is taken, with most frames ({len(longest)}); "
        f"`person={others[0].label}` takes another of {named}"
    ]


def without_gaps(path: Path, motion: Motion, frames: np.ndarray | None) -> Motion:
    """The motion with a row for every frame from the first to the last: those in which the person was not seen lie
    between their neighbours, with a note. frames: (T,) ascending numbers of those that were seen, or None."""
    if frames is None or frames.shape != (len(motion),) or frames.dtype.kind not in "iuf":
        return motion
    if not np.isfinite(frames).all() or (np.diff(frames.astype(np.float64)) <= 0).any():
        return dataclasses.replace(motion, notes=(*motion.notes, "its frame numbers do not ascend: they are left out"))
    count = float(frames[-1]) - float(frames[0]) + 1
    if count == len(motion):
        return motion
    if count > _MOST_FILLED * len(motion) or count % 1:
        raise UserError(f"{path}: its frame numbers go from {frames[0]} to {frames[-1]} in {len(motion)} frames")
    every = np.arange(int(count))
    seen = (frames - frames[0]).astype(np.int64)
    missing = np.setdiff1d(every, seen) + int(frames[0])
    low = np.clip(np.searchsorted(seen, every, "right") - 1, 0, len(seen) - 2)
    share = (every - seen[low]) / (seen[low + 1] - seen[low])
    q = quaternion_from_axis_angle(motion.poses.astype(np.float64))
    poses = axis_angle_from_quaternion(slerp(q[low], q[low + 1], share[:, None]))
    exact = share == 0
    poses[exact] = motion.poses[low[exact]]

    def between(array: np.ndarray) -> np.ndarray:
        part = share.reshape(-1, *[1] * (array.ndim - 1))
        return (array[low] * (1 - part) + array[low + 1] * part).astype(array.dtype)

    hands = motion.hands and dataclasses.replace(motion.hands, values=between(motion.hands.values))
    note = f"the person is not seen at {frames_named(missing)}: filled between the neighbours"
    expression = None if motion.expression is None else between(motion.expression)
    return dataclasses.replace(
        motion, poses=poses.astype(np.float32), trans=between(motion.trans), expression=expression,
        hands=hands, notes=(*motion.notes, note),
    )  # fmt: skip
