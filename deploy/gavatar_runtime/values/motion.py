"""A motion: poses of an SMPL-family skeleton over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..geometry.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle, slerp


@dataclasses.dataclass(frozen=True, eq=False)
class HandParameters:
    """Hand poses that only a body model's own hand data turns into rotations (`body.Hands.pose`).

    values: (T, 2, K), the left hand first: with `pca` coefficients of the model's first K principal components, else 45
    axis-angle numbers. relative: about the model's mean hand (smplx: flat_hand_mean=False), else about the flat one.
    """

    values: np.ndarray
    pca: bool = True
    relative: bool = True


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """T frames of a skeleton of J joints.

    poses: (T, J, 3) axis-angle relative to the parent joint, radians. trans: (T, 3) metres, added after posing.
    fps: frames per second. betas: (B,) shape coefficients or None. name: for messages and file names.
    leg_length: metres from hip to ankle of the person whose `trans` this is, where that person is not the body's shape;
    a body that plays the motion walks in proportion to its own legs. None leaves `trans` alone.
    expression: (T, E) coefficients of SMPL-X's facial expressions or None. hands: what takes the fingers' place in
    `poses` once a body is known, or None. notes: what was assumed when it was read, a sentence each, for the user.
    """

    poses: np.ndarray
    trans: np.ndarray
    fps: float
    betas: np.ndarray | None = None
    name: str = "motion"
    leg_length: float | None = None
    expression: np.ndarray | None = None
    hands: HandParameters | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.poses)

    def at(self, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Pose (J, 3), translation (3,) and expression (E,) or None of one frame, as `Avatar.gaussians` takes them."""
        return self.poses[frame], self.trans[frame], None if self.expression is None else self.expression[frame]

    def taken(self, frames: np.ndarray | slice | list[int]) -> Motion:
        """The motion of some frames, at the same rate."""
        return self._changed(lambda array: array[frames])

    def _changed(self, change: Callable[[np.ndarray], np.ndarray], **fields: Any) -> Motion:
        """Every array of one row a frame, but those in `fields`, replaced by what `change` makes of it."""
        arrays = {name: getattr(self, name) for name in ("poses", "trans", "expression") if name not in fields}
        fields |= {name: change(array) for name, array in arrays.items() if array is not None}
        if self.hands is not None:
            fields["hands"] = dataclasses.replace(self.hands, values=change(self.hands.values))
        return dataclasses.replace(self, **fields)

    def at_time(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """As `at`, `time` seconds after the first frame: between frames as `resampled` has them, the first and the last
        beyond them."""
        place = min(max(time * self.fps, 0.0), len(self) - 1.0)
        low = min(int(place + 1e-6), len(self) - 1)
        share = place - low
        if share < 1e-6 or low + 1 >= len(self):
            return self.at(low)
        q = quaternion_from_axis_angle(self.poses[low : low + 2].astype(np.float64))
        pose = axis_angle_from_quaternion(slerp(q[0], q[1], np.array(share))).astype(self.poses.dtype)
        others = [
            None if a is None else a[low] * (1 - share) + a[low + 1] * share for a in (self.trans, self.expression)
        ]
        trans, expression = (None if a is None else a.astype(np.float32) for a in others)
        assert trans is not None
        return pose, trans, expression

    def resampled(self, fps: float) -> Motion:
        """The motion at another frame rate: slerp per joint, all else linear; the first and last time are kept as
        far as the new rate allows. One frame stays one frame."""
        if len(self) < 2 or fps == self.fps:
            return dataclasses.replace(self, fps=fps)
        count = int(np.floor((len(self) - 1) / self.fps * fps + 1e-6)) + 1
        time = np.minimum(np.arange(count) / fps * self.fps, len(self) - 1)
        low = np.minimum(time.astype(int), len(self) - 2)
        fraction = time - low
        q = quaternion_from_axis_angle(self.poses.astype(np.float64))
        poses = axis_angle_from_quaternion(slerp(q[low], q[low + 1], fraction[:, None]))

        def between(array: np.ndarray) -> np.ndarray:
            share = fraction.reshape(-1, *[1] * (array.ndim - 1))
            return (array[low] * (1 - share) + array[low + 1] * share).astype(array.dtype)

        return self._changed(between, poses=poses.astype(self.poses.dtype), fps=fps)


def joined(motions: Sequence[Motion]) -> Motion:
    """One motion after the other, with the first one's rate, shape and name; expression and hand parameters only where
    all have them alike."""
    first = motions[0]
    expressions = [m.expression for m in motions if m.expression is not None]
    same = len(expressions) == len(motions) and len({e.shape[1] for e in expressions}) == 1
    hands = [m.hands for m in motions if m.hands is not None]
    alike = len(hands) == len(motions) and len({(h.values.shape[2], h.pca, h.relative) for h in hands}) == 1
    return dataclasses.replace(
        first,
        poses=np.concatenate([m.poses for m in motions]),
        trans=np.concatenate([m.trans for m in motions]),
        expression=np.concatenate(expressions) if same else None,
        hands=dataclasses.replace(hands[0], values=np.concatenate([h.values for h in hands])) if alike else None,
    )
