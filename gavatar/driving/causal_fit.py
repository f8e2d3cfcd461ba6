"""The pose of one person from the landmarks of one picture after the other: no look ahead.

Each picture's pose is the least of a sum of squares, found by Gauss-Newton steps from the pose before, or from a pose
read off the landmarks where that is nearer: where the landmarks are in the picture, which way each limb points in
space, how far joints usually are from rest, what they cannot do, and how far the pose is from the one before.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, rotation_between
from gavatar_runtime.values.camera import Camera

from ..preparation.anatomy import joint_ranges
from ..preparation.initial import DEFAULT_FOV, guess_camera, rays, torso_frames
from ..preparation.landmarks import BONES, INDEX, MIRROR, Landmarks
from .live_skeleton import LiveSkeleton

CALIBRATION = 45  # pictures of the person from which the bones' lengths are taken
STEPS, FIRST_STEPS = 2, 12  # of Gauss-Newton, from the pose before and from one read off the landmarks
PLACE = 0.02  # metres at the person's distance: standard deviation of a landmark in the picture
LIMB = 0.12  # standard deviation of a limb's direction from the network, of its length
LOST = 300.0  # squared standard deviations of limbs' directions at which the pose before is no place to start from
LIMIT = 0.1  # radians beyond what a joint can do that count as one standard deviation
SPEED = 6.0  # radians a second by which a joint may leave the pose before
MIRRORED = 1.5  # radians of turning that another reading of front and back costs

Start = tuple[np.ndarray, np.ndarray | None]  # rotations (22, 3, 3), and the place where that is known

_HIPS = [INDEX["left_hip"], INDEX["right_hip"]]
_TORSO = [*_HIPS, INDEX["left_shoulder"], INDEX["right_shoulder"]]
_A, _B = (np.array(ends) for ends in zip(*BONES, strict=True))
# Limbs whose direction alone gives a joint's rotation: joint, from landmark, to landmark
_LIMBS = [
    (f"{side}_{joint}", INDEX[f"{side}_{a}"], INDEX[f"{side}_{b}"])
    for joint, a, b in (("shoulder", "shoulder", "elbow"), ("elbow", "elbow", "wrist"), ("hip", "hip", "knee"),
                        ("knee", "knee", "ankle"), ("ankle", "heel", "foot_index"))
    for side in ("left", "right")
]  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """rotations: (22, 3, 3), each relative to the parent joint. joints: (22, 3) and points: (33, 3) in the world,
    metres. trans: (3,), what stands between `joints` and those of a skeleton whose pelvis is where it rests."""

    rotations: np.ndarray
    joints: np.ndarray
    points: np.ndarray
    trans: np.ndarray


class CausalFit:
    """One person followed through pictures of one camera that stands still and level.

    skeleton: at the mean lengths of bones. fov: of the camera, degrees over the longer side of its pictures. Called
    with each picture's landmarks in turn; `reset` before another person or another camera.
    """

    def __init__(self, skeleton: LiveSkeleton, fov: float = DEFAULT_FOV):
        self.mean, self.fov = skeleton, fov
        low, high, mean, sigma = joint_ranges(skeleton.names)
        self._low, self._high, self._usual, self._sigma = low[1:], high[1:], mean[1:], sigma[1:]
        self._usual_lengths = skeleton.lengths(skeleton.points)
        self._limbs = [(skeleton.names.index(joint), a, b) for joint, a, b in _LIMBS]
        self.reset()

    def reset(self) -> None:
        """Forget the person."""
        self.skeleton = self.mean
        self._measured: list[np.ndarray] = []
        self._last: Fitted | None = None
        self._time = -np.inf

    @property
    def calibrated(self) -> bool:
        """Whether the bones' lengths are settled."""
        return len(self._measured) >= CALIBRATION

    def __call__(self, image: np.ndarray, visibility: np.ndarray, world: np.ndarray, size: tuple[int, int],
                 time: float) -> Fitted:  # fmt: skip
        """The pose in one picture.

        image: (33, 2) pixels. visibility: (33,) in [0, 1]. world: (33, 3) metres around the hips along the camera's
        axes. size: width and height of the picture. time: seconds, later than the one before; else it counts as the
        next picture of 30 a second.
        """
        camera = guess_camera(*size, self.fov)
        marks = Landmarks(image[None], visibility[None], world[None])
        space = (world @ rays(camera, marks)[0].T) @ camera.T_camera_world[:3, :3]
        image, visibility, space = self._read(image, visibility, space, camera)
        self._calibrate(space, visibility)
        dt = time - self._time if 0 < time - self._time < np.inf else 1 / 30
        self._time = time
        seen = _Seen(image, visibility, space, camera)
        last, sigma = self._last, SPEED * min(dt, 0.25)
        if last is not None and self._cost(last.rotations, seen) <= LOST:
            start: Start = last.rotations, last.trans
            steps = STEPS
        else:
            start, steps = (self._from_landmarks(space), None), FIRST_STEPS
        self._last = self._descended(start, seen, None if last is None else last.rotations, sigma, steps)
        return self._last

    def _read(
        self, image: np.ndarray, visibility: np.ndarray, space: np.ndarray, camera: Camera
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The landmarks with front and back, left and right as they go best with the pose before: networks confuse
        them (`preparation.initial.unflip` chooses over the whole footage)."""
        if self._last is None or visibility[_TORSO].min() < 0.1:
            return image, visibility, space
        before = self._last.rotations[0] @ torso_frames(self.mean.points)
        away = camera.T_camera_world[2, :3]
        best, chosen = np.inf, (image, visibility, space)
        for flip in (False, True):
            points = space - 2 * (space @ away)[:, None] * away if flip else space
            for swap in (False, True):
                order = MIRROR if swap else np.arange(33)
                frame = torso_frames(points[order])
                angle = np.arccos(np.clip((np.trace(before.T @ frame) - 1) / 2, -1, 1))
                cost = angle + MIRRORED * (flip + swap) * 0.75
                if cost < best:
                    best, chosen = cost, (image[order], visibility[order], points[order])
        return chosen

    def _calibrate(self, space: np.ndarray, visibility: np.ndarray) -> None:
        """Bones as long as the median of what was seen of each; those never seen stay as the mean body's."""
        if self.calibrated:
            return
        factors = self.mean.lengths(space) / self._usual_lengths
        self._measured.append(np.where(self.mean.visible(visibility) > 0.5, factors, np.nan))
        known = np.isfinite(np.array(self._measured)).any(0)
        found = np.ones(len(known))
        found[known] = np.nanmedian(np.array(self._measured)[:, known], 0)
        self.skeleton = self.mean.scaled(found)

    def _from_landmarks(self, space: np.ndarray) -> np.ndarray:
        """(22, 3, 3) rotations read off the directions of the trunk and of each limb, without twist."""
        rotations = matrix_from_axis_angle(np.concatenate([np.zeros((1, 3)), self._usual]))
        trunk = torso_frames(space)
        if np.linalg.det(trunk) > 0.5:  # else its points lie in one place or on a line
            rotations[0] = trunk @ torso_frames(self.mean.points).T
        points = self.skeleton.points
        for j, a, b in self._limbs:
            R = rotations[0]
            for k in self._chain(j):
                R = R @ rotations[k]
            rotations[j] = rotation_between(points[b] - points[a], R.T @ (space[b] - space[a]))
        return rotations

    def _chain(self, joint: int) -> list[int]:
        """The joints between the root and one, both left out."""
        chain: list[int] = []
        k = int(self.skeleton.parents[joint])
        while k > 0:
            chain.insert(0, k)
            k = int(self.skeleton.parents[k])
        return chain

    def _cost(self, rotations: np.ndarray, seen: _Seen) -> float:
        _, _, points = self.skeleton.posed(rotations)
        miss = points[_B] - points[_A] - seen.bones(points)
        return float((seen.bone_weight * (miss**2).sum(-1)).sum())

    def _descended(self, start: Start, seen: _Seen, before: np.ndarray | None, sigma: float, steps: int) -> Fitted:
        rotations, place = start[0].copy(), start[1]
        trans = seen.placed(self.skeleton.posed(rotations)[2]) if place is None else place
        for step in range(steps + 1):
            R, joints, points = self.skeleton.posed(rotations)
            if step == steps:
                break
            H, g = self._normal(rotations, R, joints, points, trans, seen, before, sigma)
            change = -np.linalg.solve(H, g)
            turn = change[:-3].reshape(-1, 3)
            angle = np.linalg.norm(turn, axis=1, keepdims=True)
            turn = turn * np.minimum(1, 0.7 / np.maximum(angle, 1e-9))
            rotations = rotations @ matrix_from_axis_angle(turn)
            trans = trans + change[-3:]
        return Fitted(rotations, joints + trans, points + trans, trans)

    def _normal(
        self, rotations: np.ndarray, R: np.ndarray, joints: np.ndarray, points: np.ndarray, trans: np.ndarray,
        seen: _Seen, before: np.ndarray | None, sigma: float,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """(69, 69) and (69,): the normal equations over 22 rotations, each in its joint's own axes, and the place."""
        n = len(rotations)
        # a landmark's change by a joint's turn: the turn's axis in the world, crossed with the arm from joint to it
        arm = (points[:, None] - joints) * self.skeleton.above[..., None]
        J = np.cross(np.swapaxes(R, -1, -2)[None], arm[:, :, None, :])  # (33, 22, 3, 3): landmark, joint, axis, xyz
        J = np.moveaxis(J, -1, 1).reshape(33, 3, 3 * n)
        H, g = np.zeros((3 * n + 3, 3 * n + 3)), np.zeros(3 * n + 3)
        rows, miss = seen.image_rows(points, J, trans)
        H += rows.T @ rows
        g += rows.T @ miss
        w = np.sqrt(seen.bone_weight)[:, None]
        bones = ((J[_B] - J[_A]) * w[..., None]).reshape(-1, 3 * n)
        away = ((points[_B] - points[_A] - seen.bones(points)) * w).reshape(-1)
        H[: 3 * n, : 3 * n] += bones.T @ bones
        g[: 3 * n] += bones.T @ away
        self._add_anatomy(H, g, rotations)
        if before is not None:
            apart = axis_angle_from_matrix(np.swapaxes(before, -1, -2) @ rotations)
            H[range(3 * n), range(3 * n)] += sigma**-2
            g[: 3 * n] += apart.reshape(-1) / sigma**2
        H[range(3 * n + 3), range(3 * n + 3)] += 1e-3
        return H, g

    def _add_anatomy(self, H: np.ndarray, g: np.ndarray, rotations: np.ndarray) -> None:
        angles = axis_angle_from_matrix(rotations[1:])
        G = _change_of_angles(angles)
        beyond = np.maximum(angles - self._high, 0) + np.minimum(angles - self._low, 0)
        weight = self._sigma**-2 + (beyond != 0) / LIMIT**2
        pull = (angles - self._usual) * self._sigma**-2 + beyond / LIMIT**2
        blocks = np.swapaxes(G, -1, -2) @ (weight[..., None] * G)
        force = (np.swapaxes(G, -1, -2) @ pull[..., None])[..., 0]
        for j in range(len(angles)):
            part = slice(3 * j + 3, 3 * j + 6)
            H[part, part] += blocks[j]
            g[part] += force[j]


@dataclasses.dataclass(frozen=True, eq=False)
class _Seen:
    """One picture's landmarks: image (33, 2) pixels, visibility (33,), space (33, 3) along the world's axes."""

    image: np.ndarray
    visibility: np.ndarray
    space: np.ndarray
    camera: Camera

    @property
    def bone_weight(self) -> np.ndarray:
        """Of each bone's direction, 1 / m^2, before the bone's length."""
        length = np.linalg.norm(self.space[_B] - self.space[_A], axis=-1)
        return np.minimum(self.visibility[_A], self.visibility[_B]) ** 2 / (LIMB * np.maximum(length, 0.05)) ** 2

    def bones(self, points: np.ndarray) -> np.ndarray:
        """The bones of `points` turned as they are seen in space."""
        seen = self.space[_B] - self.space[_A]
        length = np.linalg.norm(points[_B] - points[_A], axis=-1, keepdims=True)
        return seen * (length / np.maximum(np.linalg.norm(seen, axis=-1, keepdims=True), 1e-6))

    def _local(self, points: np.ndarray) -> np.ndarray:
        return points @ self.camera.T_camera_world[:3, :3].T

    def placed(self, points: np.ndarray) -> np.ndarray:
        """(3,) where the turned body stands so that its landmarks fall where they are seen, by linear least squares."""
        R = self.camera.T_camera_world[:3, :3]
        local, w = self._local(points), self.visibility
        uv = (self.image - [self.camera.cx, self.camera.cy]) / [self.camera.fx, self.camera.fy]
        rows = w[:, None, None] * (uv[..., None] * R[2] - R[:2])
        rhs = w[:, None] * (local[:, :2] - uv * local[:, 2:])
        trans = np.linalg.lstsq(rows.reshape(-1, 3), rhs.reshape(-1), rcond=None)[0]
        depth = R[2] @ trans
        return trans if depth > 0.3 else 3.0 * R[2]  # nearly nothing seen: three metres away

    def image_rows(self, points: np.ndarray, J: np.ndarray, trans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows (66, N + 3) and what they miss (66,): pixels as standard deviations."""
        R = self.camera.T_camera_world[:3, :3]
        x, y, z = self._local(points + trans).T
        z = np.maximum(z, 0.1)
        f = self.camera.fx
        uv = np.stack([f * x / z + self.camera.cx, f * y / z + self.camera.cy], -1)
        D = np.zeros((len(z), 2, 3))
        D[:, 0, 0] = D[:, 1, 1] = f / z
        D[:, 0, 2], D[:, 1, 2] = -f * x / z**2, -f * y / z**2
        D = D @ R
        # a point far off, which is a wrong one, pulls less
        sigma = PLACE * f / z.mean()
        miss = (uv - self.image) / sigma
        weight = self.visibility / np.sqrt(1 + (miss**2).sum(-1) / 9)
        rows = np.concatenate([D @ J, D], -1) * (weight / sigma)[:, None, None]
        return rows.reshape(-1, rows.shape[-1]), (miss * weight[:, None]).reshape(-1)


def _change_of_angles(angles: np.ndarray) -> np.ndarray:
    """(..., 3, 3) how an axis-angle changes by a small turn in the joint's own axes (the inverse right Jacobian of
    SO(3); Sola et al., "A micro Lie theory", 2018, equation 144)."""
    angle = np.linalg.norm(angles, axis=-1)[..., None, None]
    K = np.zeros((*angles.shape[:-1], 3, 3))
    x, y, z = np.moveaxis(angles, -1, 0)
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -z, y, -x
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = z, -y, x
    small = angle < 1e-3
    safe = np.where(small, 1.0, np.minimum(angle, 3.1))
    factor = np.where(small, 1 / 12, 1 / safe**2 - (1 + np.cos(safe)) / (2 * safe * np.sin(safe)))
    return np.eye(3) + 0.5 * K + factor * (K @ K)
