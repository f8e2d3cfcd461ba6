"""How a rig would stand in a T-pose, told by its anatomy, for rigs whose OFFSETs draw nobody.

What a frame shows of a bone is its direction; how the joint's own axes lie about the bone is not to be seen. That one
angle a limb is told by what people are: knees and elbows are hinges that bend one way, feet lie ahead of ankles, palms
look down in a T-pose, and arms that hang are turned no more than it takes to bring them down. Trunk, head and collar
bones are taken as they are in the frames in which the person stands most upright (`seen_rig`).

In a T-pose an elbow bends about the vertical, a knee about the axis from right to left; the sign is that of thigh x
shin, upper arm x forearm.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..formats.bvh_file import Bvh
from ..geometry.rotations import matrix_from_axis_angle, rotation_between
from .seen_rig import SIDES, SeenRig, X, Y, Z, aside, frame, headings, see, unit, vertical_of

_TURN = np.sin(np.radians(1))  # a hinge that turns by less says nothing of its axis
_BENT = np.sin(np.radians(20))  # a limb that is bent by less, and never moves, neither
_AGREEMENT = 0.9  # of the axes of single frames: less, and the joint is no hinge in its own axes
_PLANTED = 0.04  # legs' lengths above the lowest that ankles are: the foot stands
_REVERSED = 120.0  # degrees: no limb that hangs or stands is turned that far about itself; the hinge bends backwards
_ALONG_AXIS = 15.0  # degrees: a bone that lies along one of the joint's axes bends about another of them
_CARRIED = 1 / 3  # of the way from an elbow's axis to what a hanging arm tells, for arms that bend outwards, ...
_CARRIED_MOST = 12.0  # ... in degrees at most: arms that never hang tell little


def imagined_stance(bvh: Bvh, mapping: dict[str, int], up: str) -> np.ndarray | None:
    """(J, 3, 3) orientations of the rig's joints in a T-pose, in the body's frame; None where hips and shoulders lie
    in one place. mapping: rig index by SMPL-H name. up: the world's vertical axis, `auto` finds it."""
    rig = see(bvh, mapping, up)
    if rig is None:
        return None
    _level(rig, mapping["pelvis"], "hip")
    lines = [bvh.line(mapping[f"{side}_shoulder"])[:-1] for side, _ in SIDES]
    chest = [a for a, b in zip(*lines, strict=False) if a == b][-1]
    if chest != mapping["pelvis"]:
        _level(rig, chest, "collar" if {"left_collar", "right_collar"} <= set(mapping) else "shoulder")
    for side, sign in SIDES:
        _leg(rig, side)
        _arm(rig, side, sign)
        for joint, child in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
            if f"{side}_{child}" in mapping:
                rig.straighten(f"{side}_{joint}", f"{side}_{child}")
    _feet(rig)
    return rig.start


def facing_ahead(bvh: Bvh, mapping: dict[str, int], up: str) -> np.ndarray:
    """(J, 3, 3) orientations of the rig's joints in the first frame, in the frame of the body that stands there."""
    world = bvh.world_rotations()[:1]
    at = {name: bvh.places(world)[:, j] for name, j in mapping.items()}
    trunk = at["left_shoulder"] + at["right_shoulder"] - at["left_hip"] - at["right_hip"]
    heading = headings(at, vertical_of(trunk, up))
    return world[0] if heading is None else heading[0].T @ world[0]


def _level(rig: SeenRig, joint: int, part: str) -> None:
    """Turn a joint of the trunk so that what it carries on both sides lies level, as its bones have it."""
    across = rig.places[:, rig.mapping[f"left_{part}"]] - rig.places[:, rig.mapping[f"right_{part}"]]
    own = np.einsum("tab,ta->tb", rig.world[:, joint], across).mean(0)
    if np.linalg.norm(own) > 1e-6:
        rig.start[joint] = frame((own, X), (rig.start[joint].T @ Y, Y))


def _leg(rig: SeenRig, side: str) -> None:
    hip, knee, ankle, foot = (f"{side}_{part}" for part in ("hip", "knee", "ankle", "foot"))
    shin, toes = rig.bone(knee, ankle), rig.bone(ankle, foot)
    told = None
    if shin is not None and toes is not None:  # x = up x front
        told = np.cross(rig.own(knee, shin), -rig.own(knee, aside(toes, shin)))
    _limb(rig, (hip, knee, ankle), -Y, X, told, lambda bone: _headed(rig, hip, X))
    rig.follow(ankle, knee, rig.standing)


def _arm(rig: SeenRig, side: str, sign: float) -> None:
    shoulder, elbow, wrist = (f"{side}_{part}" for part in ("shoulder", "elbow", "wrist"))
    fore, palm = rig.bone(elbow, wrist), _knuckles(rig, side)
    told = None
    if fore is not None and palm is not None:  # the thumb's side lies in front
        told = np.cross(rig.own(elbow, fore), rig.own(elbow, aside(palm, fore)))
    out, bends = sign * X, -sign * Y
    guess = lambda bone: _lowered(rig, shoulder, bone, out, bends)  # noqa: E731
    _limb(rig, (shoulder, elbow, wrist), out, bends, told, guess, carried=_CARRIED_MOST)
    _hand(rig, side, out)


def _limb(
    rig: SeenRig, joints: tuple[str, str, str], direction: np.ndarray, bends: np.ndarray, told: np.ndarray | None,
    guess: Callable[[np.ndarray], np.ndarray], carried: float = 0.0,
) -> None:  # fmt: skip
    """Stretch the two bones of a limb out in a direction of the body's frame. bends: the axis that the joint between
    them bends about, there. told: that axis in the lower joint's own axes where the joint never bends, if foot or palm
    tell it. guess: the same for the upper joint, from its bone's directions, where nothing else does, and where the
    joint between bends the wrong way. carried: degrees by which a hinge about none of the joint's axes may be brought
    nearer to the guess (`_carried`)."""
    upper, lower, _ = joints
    above, below = rig.bone(*joints[:2]), rig.bone(*joints[1:])
    if above is None:
        return
    guessed = guess(above)
    if below is None:
        _aim(rig, upper, above, direction, guessed, bends)
        rig.follow(lower, upper, rig.standing)
        return
    bones = {upper: above, lower: below}
    axes = _hinge(rig, (upper, lower), above, below)
    turned = axes[upper]
    if turned is not None and _between(turned, guessed, rig.own(upper, above)) > _REVERSED:
        axes = {joint: None if axis is None else -axis for joint, axis in axes.items()}
    if turned is not None and carried:
        axes = _carried(rig, axes, bones, guessed, carried)
    axes[lower] = told if axes[lower] is None else axes[lower]
    first, second = (lower, upper) if axes[upper] is None and axes[lower] is not None else (upper, lower)
    leading, led = axes[first], axes[second]
    _aim(rig, first, bones[first], direction, guessed if leading is None else leading, bends)
    _aim(rig, second, bones[second], direction, rig.carried(second, first, bends) if led is None else led, bends)


def _hinge(rig: SeenRig, joints: tuple[str, str], upper: np.ndarray, lower: np.ndarray) -> dict[str, np.ndarray | None]:
    """The axis that a knee or an elbow bends about, in the axes of the joint above and of the joint itself; None where
    it never bends or the axis wanders. upper, lower: (T, 3) directions of the bones.

    It is what the lower bone turns about from where the limb is straightest, as the joint above sees it: bones that
    never lie quite in one line, and a forearm that turns about itself, leave it alone.
    """
    above = rig.world[:, rig.mapping[joints[0]]]
    seen = np.einsum("tab,ta->tb", above, lower)
    bend = np.einsum("ta,ta->t", upper, lower)
    straight = unit(seen[np.argsort(-bend, kind="stable")[: max(1, len(seen) // 20)]].mean(0))
    turns = np.cross(straight, seen)
    if np.linalg.norm(turns, axis=-1).max() < _TURN:  # it never moves: as it is bent
        turns = np.cross(np.einsum("tab,ta->tb", above, upper), seen)
        if np.linalg.norm(turns, axis=-1).max() < _BENT:
            return dict.fromkeys(joints)
    size = np.linalg.norm(turns, axis=-1)
    turns = turns[size > size.max() / 2]
    if np.linalg.norm(turns.sum(0)) < _AGREEMENT * np.linalg.norm(turns, axis=-1).sum():
        return dict.fromkeys(joints)
    axis = unit(turns.sum(0))
    own = rig.own(joints[1], above @ axis)
    return {joints[0]: axis, joints[1]: own if np.linalg.norm(own) > _AGREEMENT else None}


def _carried(
    rig: SeenRig, axes: dict[str, np.ndarray | None], bones: dict[str, np.ndarray], guessed: np.ndarray, most: float
) -> dict[str, np.ndarray | None]:
    """The axes of an elbow turned about their bones a part of the way to the guess for the upper arm.

    Rigs after bone files (CMU's) bend their elbows about an axis that stands 30 degrees outwards from where the arm of
    the body bends; those whose elbow bends about one of the joint's own axes are left alone.
    """
    upper = next(iter(axes))
    bone, hinge = unit(rig.own(upper, bones[upper])), axes[upper]
    if hinge is None or _axis_near(bone, hinge) is not None:
        return axes
    turn = _CARRIED * np.radians(_between(hinge, guessed, bone))
    turn = min(turn, np.radians(most)) * (np.sign(np.cross(hinge, guessed) @ bone) or 1)
    out = {}
    for joint, axis in axes.items():
        along = unit(rig.own(joint, bones[joint]))
        out[joint] = None if axis is None else matrix_from_axis_angle(turn * along) @ axis
    return out


def _feet(rig: SeenRig) -> None:
    """A foot that stands on the floor is level, toes ahead; one that never does is pitched as the other is."""
    heights = {side: rig.places[:, rig.mapping[f"{side}_ankle"]] @ rig.vertical for side, _ in SIDES}
    leg = np.mean([rig.length(f"{side}_hip", f"{side}_knee", f"{side}_ankle") for side in heights])
    floor = min(np.quantile(height, 0.05) for height in heights.values())
    pitch = None
    for side in sorted(heights, key=lambda side: np.quantile(heights[side], 0.05)):
        ankle, foot = f"{side}_ankle", f"{side}_foot"
        toes = rig.bone(ankle, foot)
        planted = np.flatnonzero(heights[side] < floor + _PLANTED * leg)
        if toes is not None and len(planted):
            j, ahead = rig.mapping[ankle], rig.own(ankle, toes)
            own_up = rig.own(ankle, np.broadcast_to(rig.vertical, (len(planted), 3)), planted)
            rig.start[j] = frame((own_up, Y), (ahead, Z))
            pitch = rig.start[j] @ ahead
        elif toes is not None and pitch is not None:
            _aim(rig, ankle, toes, pitch, rig.carried(ankle, f"{side}_knee", X), X)
        if foot in rig.mapping:
            rig.follow(foot, ankle, planted if len(planted) else rig.standing)


def _hand(rig: SeenRig, side: str, out: np.ndarray) -> None:
    """A hand lies straight on its forearm, its knuckles in front, or where there are none, turned about itself as it
    hangs: a thumb moves too much to tell. Fingers but the thumb lie straight on it."""
    wrist, elbow = f"{side}_wrist", f"{side}_elbow"
    if wrist not in rig.mapping:
        return
    rig.follow(wrist, elbow, rig.standing)
    known = next((n for n in (f"{side}_middle1", f"{side}_index1") if n in rig.mapping), None)
    bone = rig.outwards(wrist, f"{side}_thumb1") if known is None else rig.bone(wrist, known)
    palm = _knuckles(rig, side) if len(_known_knuckles(rig, side)) > 1 else None
    if bone is not None:
        axis = rig.start[rig.mapping[wrist]].T @ Z if palm is None else rig.own(wrist, palm)
        _aim(rig, wrist, bone, out, axis, Z)
    fingers = [name for name in rig.mapping if name.startswith(side) and name[-1] in "123"]
    for finger in sorted(fingers, key=lambda name: rig.mapping[name]):
        rig.follow(finger, wrist, rig.standing)
        bone = rig.bone(finger, f"{finger[:-1]}{int(finger[-1]) + 1}")
        if bone is not None and "thumb" not in finger:
            _aim(rig, finger, bone, out, rig.start[rig.mapping[finger]].T @ Z, Z)


def _knuckles(rig: SeenRig, side: str) -> np.ndarray | None:
    """(T, 3) from the little finger's side of a hand to the index finger's, in the world; where only the thumb is
    known, the way that it points aside from the forearm."""
    known = _known_knuckles(rig, side)
    fore = rig.bone(f"{side}_elbow", f"{side}_wrist")
    if len(known) > 1:
        across = rig.places[:, known[0]] - rig.places[:, known[-1]]
    elif f"{side}_thumb1" in rig.mapping and fore is not None:
        thumb = rig.bone(f"{side}_thumb1", f"{side}_thumb2")
        across = np.zeros((1, 3)) if thumb is None else aside(thumb, fore)
    else:
        return None
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    return across / length if length.min() > 1e-6 else None


def _known_knuckles(rig: SeenRig, side: str) -> list[int]:
    """Rig joints of the fingers' first joints, from the index finger's side."""
    names = [f"{side}_{finger}1" for finger in ("index", "middle", "ring", "pinky")]
    return [rig.mapping[name] for name in names if name in rig.mapping]


def _headed(rig: SeenRig, joint: str, axis: np.ndarray) -> np.ndarray:
    """An axis of the body's frame in those of a joint, in the standing frames."""
    return rig.own(joint, rig.heading @ axis, rig.standing)


def _lowered(rig: SeenRig, joint: str, bone: np.ndarray, out: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The axis of the T-pose in those of a limb that was brought from there the shortest way, in the standing
    frames."""
    bone = np.einsum("sab,sa->sb", rig.heading, bone[rig.standing])
    brought = rig.heading @ rotation_between(np.broadcast_to(out, bone.shape), bone)
    return rig.own(joint, brought @ axis, rig.standing)


def _between(one: np.ndarray, other: np.ndarray, bone: np.ndarray) -> float:
    """Degrees between two axes as seen along a bone."""
    one, other = (aside(axis, unit(bone)) for axis in (one, other))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def _aim(
    rig: SeenRig, joint: str, bone: np.ndarray, direction: np.ndarray, own_axis: np.ndarray, axis: np.ndarray
) -> None:
    """Turn a joint so that its bone points in a direction and an axis of its own, as near as may be, along another.

    Rigs whose bones lie along a joint's axis bend about another of its axes: an estimate that comes near one is it.
    """
    own_bone = unit(rig.own(joint, bone))
    near = _axis_near(own_bone, own_axis)
    rig.start[rig.mapping[joint]] = frame((own_bone, direction), (own_axis if near is None else near, axis))


def _axis_near(bone: np.ndarray, axis: np.ndarray) -> np.ndarray | None:
    """(3,) the one of a joint's axes, with its sign, that an estimate of a hinge is near to, where the bone lies along
    another; else None."""
    if np.abs(bone).max() <= 0.999:
        return None
    across = aside(axis, bone)
    along = int(np.argmax(np.abs(across)))
    if abs(across[along]) <= np.cos(np.radians(_ALONG_AXIS)) * np.linalg.norm(across):
        return None
    return np.eye(3)[along] * np.sign(across[along])
