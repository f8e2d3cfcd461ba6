"""How feet meet the floor in a motion: whether they slide while they bear weight, and whether they sink in."""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar_runtime.values.body import BodyData
from gavatar_runtime.values.motion import Motion

CONTACT = 0.004  # metres over the floor: a point of the sole lower than that before and after a frame bears weight
FOOT_WEIGHT = 0.6  # of ankle and toes in a vertex' skinning, for it to be one of the foot


@dataclasses.dataclass(frozen=True)
class Footing:
    """stances: how many times a foot was set down, or stood throughout. slide: metres, the longest way of a sole in a
    stance; mean_slide: of the average stance. speed: metres a second, the fastest of a sole that bears weight.
    sunk: metres of the deepest point of a foot below the floor. flight: share of the time with both feet off it."""

    stances: int
    slide: float
    mean_slide: float
    speed: float
    sunk: float
    flight: float


def footing(body: BodyData, motion: Motion, *, floor_speed: float = 0.0) -> Footing:
    """Of a motion on a body of mean shape, both feet.

    motion: of the body's joints, `trans` scaled to its legs (`fit_motion`, `scaled_to_legs`). floor_speed: metres a
    second that the floor comes towards the person, along -z, as under who walks in place. The floor is as high as the
    soles in the T-pose. A sole's way is that of its lowest point: from one frame to the next the horizontal distance
    of the vertex that is lowest in the higher of the two, against the floor; a stance is a run of frames in which that
    vertex is within `CONTACT` of the floor.
    """
    level = float(body.shaped(None)[0][:, 1].min())
    ways: list[np.ndarray] = []
    sunk, aloft = 0.0, np.ones(len(motion) - 1, bool)
    for side in ("left", "right"):
        points = _foot(body, motion, side)
        points[..., 1] -= level
        points[..., 2] += floor_speed * np.arange(len(motion))[:, None] / motion.fps
        height = np.maximum(points[1:, :, 1], points[:-1, :, 1])
        lowest = np.argmin(height, 1)[:, None]
        steps = np.linalg.norm(np.diff(points[..., [0, 2]], axis=0), axis=-1)
        step = np.take_along_axis(steps, lowest, 1)[:, 0]
        bears = np.take_along_axis(height, lowest, 1)[:, 0] < CONTACT
        sunk, aloft = max(sunk, -float(points[..., 1].min())), aloft & ~bears
        edges = np.flatnonzero(np.diff(np.concatenate([[False], bears, [False]]).astype(int)))
        ways += [step[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    slides = [float(way.sum()) for way in ways] or [0.0]
    fastest = max((float(way.max()) for way in ways), default=0.0) * motion.fps
    return Footing(len(ways), max(slides), float(np.mean(slides)), fastest, max(sunk, 0.0), float(aloft.mean()))


def _foot(body: BodyData, motion: Motion, side: str) -> np.ndarray:
    """(T, V, 3) the vertices of a foot."""
    rows = [body.joint_names.index(f"{side}_{name}") for name in ("ankle", "foot")]
    chosen = np.flatnonzero(body.lbs_weights[:, rows].sum(1) > FOOT_WEIGHT)
    part = dataclasses.replace(
        body, v_template=body.v_template[chosen], lbs_weights=body.lbs_weights[chosen],
        posedirs=None if body.posedirs is None else body.posedirs[chosen], shapedirs=body.shapedirs[chosen],
    )  # fmt: skip
    A = body.skinning(motion.poses.astype(np.float64))[..., :3, :]
    vertices = part.v_template + part.pose_offsets(motion.poses.astype(np.float64))
    blended = np.einsum("vj,tjab->tvab", part.lbs_weights, A)
    return np.einsum("tvab,tvb->tva", blended[..., :3], vertices) + blended[..., 3] + motion.trans[:, None]
