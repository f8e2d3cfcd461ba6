"""A motion of one skeleton of the SMPL family brought to the joints, hands and legs of a body."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..values.body import Hands, check_motion_fits
from ..values.motion import HandParameters, Motion
from ..values.skeletons import _BY_COUNT, BODY, FINGERS

HAND_DATA, EXPRESSIONS = "hand components", "expressions"  # what a body may lack besides joints


def fit_motion(
    motion: Motion,
    joint_names: tuple[str, ...],
    rest_pose: np.ndarray | None = None,
    *,
    hands: Hands | None = None,
    num_expression: int = 0,
) -> tuple[Motion, tuple[str, ...]]:
    """The motion with one rotation for each of `joint_names`, and the names of what moves in it but what the body
    lacks: joints, `HAND_DATA` and `EXPRESSIONS`.

    A motion does not name its joints: their number (22, 24, 52 or 55) tells the skeleton. Joints that the motion lacks
    keep their rest rotation, `rest_pose` (J, 3), zero if None. With any other number the joints are taken to be in the
    body's order. hands: of the body; the motion's hand parameters become finger rotations by them. num_expression: how
    many coefficients the body has; those beyond are left out.
    """
    fitted, ignored = _fit_joints(motion, joint_names, rest_pose)
    expression, lacking = motion.expression, []
    if expression is not None:
        if num_expression == 0 and expression.any():
            lacking.append(EXPRESSIONS)
        expression = expression[:, :num_expression] if num_expression else None
    fitted = dataclasses.replace(fitted, expression=expression, hands=None)
    given = motion.hands
    if given is not None:
        if set(FINGERS) <= set(joint_names) and hands is not None and _has_data(hands, given):
            rows = [joint_names.index(name) for name in FINGERS]
            sides = [hands.pose(i, given.values[:, i], pca=given.pca, relative=given.relative) for i in (0, 1)]
            fitted.poses[:, rows] = np.concatenate(sides, 1)
        elif given.values.any():
            lacking.append(HAND_DATA)
    return fitted, (*ignored, *lacking)


def _has_data(hands: Hands, given: HandParameters) -> bool:
    """Whether a body's hand data turn the parameters into rotations. A file without any has a mean of zeros."""
    return given.values.shape[2] <= hands.components.shape[1] if given.pca else bool(hands.components.shape[1])


def _fit_joints(
    motion: Motion, joint_names: tuple[str, ...], rest_pose: np.ndarray | None
) -> tuple[Motion, tuple[str, ...]]:
    count = motion.poses.shape[1]
    names = tuple(joint_names) if count == len(joint_names) else _BY_COUNT.get(count)
    if names is None or not set(BODY) <= set(joint_names):
        surplus = tuple(f"joint {j}" for j in range(len(joint_names), count) if motion.poses[:, j].any())
        poses = check_motion_fits(motion.poses, len(joint_names)).copy()
        return dataclasses.replace(motion, poses=poses), surplus
    poses = np.zeros((len(motion), len(joint_names), 3), motion.poses.dtype)
    if rest_pose is not None:
        poses += rest_pose.astype(poses.dtype)
    ignored = []
    place = {name: j for j, name in enumerate(joint_names)}
    for j, name in enumerate(names):
        if name in place:
            poses[:, place[name]] = motion.poses[:, j]
        elif motion.poses[:, j].any():
            ignored.append(name)
    return dataclasses.replace(motion, poses=poses), tuple(ignored)


def scaled_to_legs(motion: Motion, joint_names: tuple[str, ...], joints: np.ndarray) -> Motion:
    """The motion with its `trans` scaled from the legs that it was made with to those of a body at rest, whose joints
    (J, 3) are in metres; unchanged when it does not say or the body has no such joints."""
    names = ("left_hip", "left_knee", "left_ankle")
    if motion.leg_length is None or not set(names) <= set(joint_names):
        return motion
    hip, knee, ankle = (joints[joint_names.index(name)] for name in names)
    leg = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
    trans = (motion.trans * (leg / motion.leg_length)).astype(motion.trans.dtype)
    return dataclasses.replace(motion, trans=trans, leg_length=leg)
