"""What the frames of a motion show of a rig: directions of bones, the frames in which the person stands, the way it
faces. Directions of the body's frame: left +x, up +y, front +z."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from ..formats.bvh_file import Bvh

X, Y, Z = np.eye(3)
SIDES = (("left", 1.0), ("right", -1.0))
_STANDING = 0.1  # of the frames, those most upright


@dataclasses.dataclass
class SeenRig:
    """mapping: rig index by SMPL-H name. world: (T, J, 3, 3), places: (T, J, 3) in the rig's world. vertical: (3,) its
    axis upwards. standing: (S,) the frames in which the person stands most upright. heading: (S, 3, 3) from the body's
    frame to the world in those. start: (J, 3, 3) from a joint's own axes to the body's frame at rest, as far as it is
    known."""

    bvh: Bvh
    mapping: dict[str, int]
    world: np.ndarray
    places: np.ndarray
    vertical: np.ndarray
    standing: np.ndarray
    heading: np.ndarray
    start: np.ndarray

    def bone(self, joint: str, child: str) -> np.ndarray | None:
        """(T, 3) unit directions in the world from a joint to another, or to its End Site; None without either."""
        j, k = self.mapping[joint], self.mapping.get(child)
        bone = self.world[:, j] @ self.bvh.tips[j] if k is None else self.places[:, k] - self.places[:, j]
        length = np.linalg.norm(bone, axis=-1, keepdims=True)
        return bone / length if np.isfinite(length).all() and length.min() > 1e-6 else None

    def outwards(self, joint: str, without: str) -> np.ndarray | None:
        """(T, 3) unit directions from a joint to the one farthest from it among those below it, or to its End Site;
        None without any. without: a joint that does not count, with all below it."""
        j, barred = self.mapping[joint], self.mapping.get(without, -1)
        lines = [self.bvh.line(k) for k in range(len(self.bvh.names))]
        below = [line[-1] for line in lines if j in line[:-1] and barred not in line]
        if not below:
            return self.bone(joint, "")
        far = max(below, key=lambda k: np.linalg.norm(self.places[:, k] - self.places[:, j], axis=-1).mean())
        bone = self.places[:, far] - self.places[:, j]
        length = np.linalg.norm(bone, axis=-1, keepdims=True)
        return bone / length if length.min() > 1e-6 else None

    def own(self, joint: str, directions: np.ndarray, frames: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(3,) the mean of directions (F, 3) of the world in the joint's own axes; its length tells their agreement."""
        return np.einsum("tab,ta->tb", self.world[frames, self.mapping[joint]], directions).mean(0)

    def carried(self, joint: str, other: str, axis: np.ndarray) -> np.ndarray:
        """(3,) an axis of the body at rest, as another joint turned it, in the axes of this one, on average."""
        j = self.mapping[other]
        return self.own(joint, self.world[:, j] @ (self.start[j].T @ axis))

    def length(self, *joints: str) -> float:
        """The mean length of a row of bones."""
        at = [self.places[:, self.mapping[joint]] for joint in joints]
        return float(sum(np.linalg.norm(a - b, axis=-1).mean() for a, b in itertools.pairwise(at)))

    def follow(self, joint: str, parent: str, frames: np.ndarray) -> None:
        """At rest the joint lies to its parent as it does on average in those frames."""
        self._follow(self.mapping[joint], self.mapping[parent], frames)

    def straighten(self, joint: str, child: str) -> None:
        """Joints between two of a limb, which share its twist, lie to their parents as in the standing frames."""
        line = self.bvh.line(self.mapping[child])
        if self.mapping[joint] in line:
            for k, j in itertools.pairwise(line[line.index(self.mapping[joint]) : -1]):
                self._follow(j, k, self.standing)

    def _follow(self, j: int, k: int, frames: np.ndarray) -> None:
        local = np.einsum("sba,sbc->ac", self.world[frames, k], self.world[frames, j])
        self.start[j] = self.start[k] @ nearest_rotation(local)


def see(bvh: Bvh, mapping: dict[str, int], up: str) -> SeenRig | None:
    """The rig with trunk, head and all else at rest as in the frames in which the person stands most upright; None
    where hips and shoulders lie in one place. up: the world's vertical axis, `auto` finds it."""
    world = bvh.world_rotations()
    places = bvh.places(world)
    places += (bvh.track(mapping["pelvis"], world) - places[:, mapping["pelvis"]])[:, None]
    at = {name: places[:, j] for name, j in mapping.items()}
    trunk = (at["left_shoulder"] + at["right_shoulder"] - at["left_hip"] - at["right_hip"]) / 2
    if np.linalg.norm(trunk, axis=-1).max() < 1e-6:
        return None
    vertical = vertical_of(trunk, up)
    standing = _standing(at, trunk, vertical)
    heading = headings({name: place[standing] for name, place in at.items()}, vertical)
    if heading is None:
        return None
    start = nearest_rotation(np.einsum("sba,sjbc->jac", heading, world[standing]))
    return SeenRig(bvh, mapping, world, places, vertical, standing, heading, start)


def vertical_of(trunk: np.ndarray, up: str) -> np.ndarray:
    """(3,) the signed axis that `up` names, or the one that trunks (T, 3) point along on average."""
    if up != "auto":
        return np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    mean = trunk.mean(0)
    axis = int(np.argmax(np.abs(mean)))
    return np.eye(3)[axis] * (np.sign(mean[axis]) or 1)


def headings(at: dict[str, np.ndarray], vertical: np.ndarray) -> np.ndarray | None:
    """(S, 3, 3) from the body's frame to the world: up is the vertical, left is where both hips and shoulders lie. at:
    places (S, 3) by SMPL-H name. None where they lie above each other."""
    left = sum(at[f"left_{part}"] - at[f"right_{part}"] for part in ("hip", "shoulder"))
    left = left - (left @ vertical)[:, None] * vertical
    length = np.linalg.norm(left, axis=-1, keepdims=True)
    if length.min() < 1e-6:
        return None
    left = left / length
    up = np.broadcast_to(vertical, left.shape)
    return np.stack([left, up, np.cross(left, up)], -1)


def _standing(at: dict[str, np.ndarray], trunk: np.ndarray, vertical: np.ndarray) -> np.ndarray:
    """The frames in which the trunk is most upright over legs that are straight and stand under it."""
    score = trunk @ vertical / np.maximum(np.linalg.norm(trunk, axis=-1), 1e-9)
    for side, _ in SIDES:
        hip, knee, ankle = (at[f"{side}_{part}"] for part in ("hip", "knee", "ankle"))
        length = np.linalg.norm(hip - knee, axis=-1) + np.linalg.norm(knee - ankle, axis=-1)
        score = score + (hip - ankle) @ vertical / np.maximum(length, 1e-9)
    count = max(1, int(np.ceil(_STANDING * len(score))))
    return np.sort(np.argsort(-score, kind="stable")[:count])


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(np.linalg.norm(vector), 1e-12)


def aside(directions: np.ndarray, bone: np.ndarray) -> np.ndarray:
    """(..., 3) what of directions is at right angles to a bone of length one."""
    return directions - (directions * bone).sum(-1, keepdims=True) * bone


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """(..., 3, 3) the rotations nearest to sums of rotations; of a sum without a direction, some rotation."""
    U, _, Vt = np.linalg.svd(matrix)
    U = U.copy()
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]
    return U @ Vt


def frame(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(3, 3) the rotation that takes the first's own direction to its target, and the second's as near as may be."""
    own, target = (_axes(a, b) for a, b in zip(first, second, strict=True))
    return target @ own.T


def _axes(main: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(3, 3) columns: `main`, what of `other` is at right angles to it, and their cross product."""
    main = unit(main)
    across = aside(other, main)
    if np.linalg.norm(across) < 1e-9:
        across = aside(np.eye(3)[int(np.argmin(np.abs(main)))], main)
    across = unit(across)
    return np.stack([main, across, np.cross(main, across)], -1)
