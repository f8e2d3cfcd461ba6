"""One motion after another, the person going on from where the last one left them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..errors import WrongValue
from ..geometry.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle, quaternion_product, slerp
from ..values.motion import Motion
from .builtin.curves import eased


def in_sequence(motions: Sequence[Motion], blend: float) -> Motion:
    """The motions one after another as one, at the highest of their rates.

    motions: of one body: fitted to it (`Avatar.fit`), so that joints, legs and expressions agree; hand parameters that
    are left are dropped. blend: seconds for which the end of each and the beginning of the next are played at once,
    each joint by slerp from one to the other, with speed and acceleration zero at both ends. Where the pelvis is over
    the floor and where it faces go on from where they are: in a blend by the one's speed and more and more the other's,
    after it as the motion has it. Heights are blended. Feet may slide in blends, and only there. A motion shorter than
    its blends and one frame waits in its first and last frame. So the whole lasts as long as the motions, less the
    blends. With blend 0 the next pose follows at once. The shape is the first's; the name is all of theirs. Raises
    WrongValue for no motion, for motions of different numbers of joints or of expressions, and for a blend that is
    negative or no number."""
    if not motions:
        raise WrongValue("a sequence needs a motion at least")
    if isinstance(blend, bool) or not (isinstance(blend, (int, float)) and 0 <= blend < 1e4):
        raise WrongValue(f"`blend={blend}`: give seconds, zero or more")
    _check_alike(motions)
    if len(motions) == 1:
        return motions[0]
    fps = max(motion.fps for motion in motions)
    width = round(blend * fps)
    parts = [_plain(motion.resampled(fps)) for motion in motions]
    parts = [_lasting(p, width, before=i > 0, after=i < len(parts) - 1) for i, p in enumerate(parts)]
    whole = parts[0]
    for part in parts[1:]:
        whole = _appended(whole, part, width)
    legs = {motion.leg_length for motion in motions}
    notes = tuple(dict.fromkeys(note for motion in motions for note in motion.notes))
    return dataclasses.replace(
        whole, name="_".join(motion.name for motion in motions), notes=notes,
        leg_length=legs.pop() if len(legs) == 1 else None,
    )  # fmt: skip


def _check_alike(motions: Sequence[Motion]) -> None:
    joints = {motion.poses.shape[1] for motion in motions}
    faces = {motion.expression.shape[1] for motion in motions if motion.expression is not None}
    for what, counts in (("joints", joints), ("expressions", faces)):
        if len(counts) > 1:
            different = " and ".join(map(str, sorted(counts)))
            raise WrongValue(f"motions of {different} {what} cannot follow each other: fit them to one body")


def _plain(motion: Motion) -> Motion:
    return dataclasses.replace(motion, hands=None)


def _lasting(motion: Motion, width: int, *, before: bool, after: bool) -> Motion:
    """The motion with as many frames as its blends take, and one."""
    lacking = max(0, width * (before + after) + 1 - len(motion))
    early = 0 if not before else lacking if not after else lacking // 2
    index = np.concatenate([np.zeros(early, int), np.arange(len(motion)), np.full(lacking - early, len(motion) - 1)])
    return motion.taken(index)


def _appended(one: Motion, other: Motion, width: int) -> Motion:
    """Both, the last `width` frames of the one blended with the first of the other."""
    cut = len(one) - width
    q1, q2 = (quaternion_from_axis_angle(m.poses.astype(np.float64)) for m in (one, other))
    h1, h2 = (np.unwrap(_heading(q[:, 0])) for q in (q1, q2))
    share = eased((np.arange(width) + 1) / (width + 1))
    # the way and the turn of each frame since the one before, in the frame of the pelvis' heading
    step1, turn1 = _steps(one.trans, h1)
    step2, turn2 = _steps(other.trans, h2)
    share_of_all = np.concatenate([share, np.ones(len(other) - width)])
    step, turn = (_padded(a[cut:], b) for a, b in ((step1, step2), (turn1, turn2)))
    step = step[0] * (1 - share_of_all[:, None]) + step[1] * share_of_all[:, None]
    turn = turn[0] * (1 - share_of_all) + turn[1] * share_of_all
    heading = h1[cut - 1] + np.cumsum(turn)
    before = np.concatenate([h1[cut - 1 : cut], heading[:-1]])
    trans = np.empty((len(other), 3))
    trans[:, [0, 2]] = one.trans[cut - 1, [0, 2]] + np.cumsum(_turned(step, before), 0)
    trans[:, 1] = other.trans[:, 1]
    q = q2.copy()
    q[:, 0] = quaternion_product(_about_y(-h2), q2[:, 0])
    if width:
        ending = q1[cut:].copy()
        ending[:, 0] = quaternion_product(_about_y(-h1[cut:]), ending[:, 0])
        q[:width] = slerp(ending, q[:width], share[:, None])
        trans[:width, 1] += (one.trans[cut:, 1] - other.trans[:width, 1]) * (1 - share)
    q[:, 0] = quaternion_product(_about_y(heading), q[:, 0])
    poses = axis_angle_from_quaternion(q)
    return dataclasses.replace(
        one, poses=np.concatenate([one.poses[:cut], poses.astype(one.poses.dtype)]),
        trans=np.concatenate([one.trans[:cut], trans.astype(one.trans.dtype)]),
        expression=_expressions(one, other, cut, share),
    )  # fmt: skip


def _expressions(one: Motion, other: Motion, cut: int, share: np.ndarray) -> np.ndarray | None:
    if one.expression is None and other.expression is None:
        return None
    count = next(e.shape[1] for e in (one.expression, other.expression) if e is not None)
    e1, e2 = (
        np.zeros((len(m), count), np.float32) if m.expression is None else m.expression.copy() for m in (one, other)
    )
    e2[: len(share)] = e1[cut:] * (1 - share[:, None]) + e2[: len(share)] * share[:, None]
    return np.concatenate([e1[:cut], e2])


def _steps(trans: np.ndarray, heading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 2) x and z that the pelvis goes to each frame from the one before, as that one faces, and (T,) by how much it
    turns; to the first as to the second."""
    way = np.diff(trans[:, [0, 2]].astype(np.float64), axis=0)
    step, turn = _turned(way, -heading[:-1]), np.diff(heading)
    if not len(step):
        return np.zeros((1, 2)), np.zeros(1)
    return np.concatenate([step[:1], step]), np.concatenate([turn[:1], turn])


def _padded(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as long as the second, the first with zeros."""
    return np.concatenate([first, np.zeros((len(second) - len(first), *first.shape[1:]))]), second


def _heading(quaternion: np.ndarray) -> np.ndarray:
    """(T,) radians about y of the turn that, followed by one about a level axis, is the rotation (T, 4) wxyz; of a body
    upside down, where there is none, zero."""
    return 2 * np.arctan2(quaternion[:, 2], quaternion[:, 0])


def _turned(way: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """(T, 2) x and z turned about y."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * way[:, 0] + s * way[:, 1], c * way[:, 1] - s * way[:, 0]], -1)


def _about_y(angle: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle / 2), zero, np.sin(angle / 2), zero], -1)
