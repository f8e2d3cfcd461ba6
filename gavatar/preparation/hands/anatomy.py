"""What fingers can do, on any body of the SMPL family whose rest pose is a T-pose with flat hands.

Each joint turns about three axes that follow from the rest pose: along its bone, across it (bending towards the palm
is positive) and about the palm's normal (spreading). Ranges are generous ones from anatomy and the relaxed hand is
what a hand does that hangs; both are rounded and fitted to no data.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar_runtime.values.body import BodyData

from .landmarks import FINGERS, SIDES

# (twist, bend, spread) radians: low, high, at rest, standard deviation
_FIRST = ((-0.2, -0.5, -0.4), (0.2, 1.7, 0.4), (0.0, 0.35, 0.0), (0.06, 0.5, 0.15))
_SECOND = ((-0.05, -0.1, -0.03), (0.05, 1.9, 0.03), (0.0, 0.5, 0.0), (0.02, 0.6, 0.01))
_THIRD = ((-0.05, -0.15, -0.03), (0.05, 1.4, 0.03), (0.0, 0.3, 0.0), (0.02, 0.4, 0.01))
_THUMB = (
    ((-0.7, -0.9, -0.8), (0.7, 0.9, 0.8), (0.0, 0.1, 0.0), (0.25, 0.35, 0.3)),
    ((-0.3, -0.6, -0.4), (0.3, 1.0, 0.4), (0.0, 0.15, 0.0), (0.1, 0.35, 0.15)),
    ((-0.1, -0.4, -0.1), (0.1, 1.4, 0.1), (0.0, 0.2, 0.0), (0.05, 0.4, 0.05)),
)
_CURL = {"index": 0.8, "middle": 1.0, "ring": 1.15, "pinky": 1.25}  # fingers hang the more bent, the farther out


@dataclasses.dataclass(frozen=True)
class HandAnatomy:
    """The left and the right hand of one body of one shape.

    joints: (2, 16) indices, the wrist, then the fingers' in the order of `FINGERS`. rest: (2, 16, 3) metres, around
    the wrist. forearm: (2, 3) unit vectors from the elbow to the wrist at rest. tips: (2, 5, 3) the fingers' ends,
    around their third joints. axes: (2, 15, 3, 3) columns along, across and about the normal, in the rest pose.
    low, high, relaxed, sigma: (15, 3) radians about those axes.
    """

    joints: np.ndarray
    rest: np.ndarray
    forearm: np.ndarray
    tips: np.ndarray
    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    relaxed: np.ndarray
    sigma: np.ndarray

    def relaxed_pose(self) -> np.ndarray:
        """(2, 15, 3) axis-angle of fingers that hang, radians."""
        return np.einsum("hjab,jb->hja", self.axes, self.relaxed)


def has_fingers(data: BodyData) -> bool:
    """Whether a body has the joints of both hands' fingers."""
    return all(f"{s}_{f}{k}" in data.joint_names for s in SIDES for f in FINGERS for k in (1, 2, 3))


def hand_anatomy(data: BodyData, betas: np.ndarray | None) -> HandAnatomy:
    """Of a body that has fingers (`has_fingers`)."""
    place = {name: k for k, name in enumerate(data.joint_names)}
    vertices, at_rest = data.shaped(betas)
    chosen = np.array([[place[f"{s}_wrist"], *(place[f"{s}_{f}{k}"] for f in FINGERS for k in (1, 2, 3))]
                       for s in SIDES])  # fmt: skip
    rest = at_rest[chosen]
    elbows = at_rest[[place[f"{s}_elbow"] for s in SIDES]]
    forearm = rest[:, 0] - elbows
    tips = np.zeros((2, 5, 3))
    axes = np.zeros((2, 15, 3, 3))
    for h in range(2):
        normal = np.cross(rest[h, 4] - rest[h, 0], rest[h, 13] - rest[h, 0])  # of index and pinky: out of the palm ...
        normal *= np.sign(normal[1]) * -1.0  # ... which faces down in a T-pose
        normal /= np.linalg.norm(normal)
        for f in range(5):
            chain = rest[h, 1 + 3 * f : 4 + 3 * f]
            last = chosen[h, 3 + 3 * f]
            end = (chain[2] - chain[1]) / np.linalg.norm(chain[2] - chain[1])
            own = vertices[data.lbs_weights[:, last] > 0.5] - chain[2]
            tip = own[(own @ end).argmax()] if len(own) else end * 0.02
            tips[h, f] = end * (tip @ end) * 0.85 + 0.15 * tip  # a fingertip's landmark lies on the pad, inside
            points = np.r_[chain, [chain[2] + tips[h, f]]]
            for k in range(3):
                axes[h, 3 * f + k] = _axes(points[k + 1] - points[k], normal)
    tables = np.concatenate([np.array(_THUMB), *[np.array([_FIRST, _SECOND, _THIRD])] * 4])  # (15, 4, 3)
    low, high, relaxed, sigma = tables.transpose(1, 0, 2).copy()
    for f, finger in enumerate(FINGERS[1:], 1):
        relaxed[3 * f : 3 * f + 3] *= _CURL[finger]
    unit = forearm / np.linalg.norm(forearm, axis=-1, keepdims=True)
    return HandAnatomy(chosen, rest - rest[:, :1], unit, tips, axes, low, high, relaxed, sigma)


def _axes(bone: np.ndarray, normal: np.ndarray) -> np.ndarray:
    along = bone / np.linalg.norm(bone)
    across = np.cross(along, normal)  # turning about it takes the bone towards the palm's normal, which is the palm
    across /= np.linalg.norm(across)
    return np.stack([along, across, np.cross(along, across)], -1)
