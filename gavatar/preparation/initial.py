"""Where a fit starts: the camera, which way the person faces in every frame, and where they stand."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix, rotation_between, slerp
from gavatar_runtime.values.camera import Camera

from .coverage import in_picture
from .landmarks import INDEX, MIRROR, Landmarks

DEFAULT_FOV = 40.0  # degrees over the image's longer side: between a phone's main lens (65) and a portrait shot (25)
_TORSO = [INDEX[f"{side}_{part}"] for part in ("shoulder", "hip") for side in ("left", "right")]
_SHOULDERS, _HIPS = _TORSO[:2], _TORSO[2:]
GUESSED_HIPS = 0.3  # what a torso counts whose shoulders alone are seen: the network guesses where its hips are


def guess_camera(width: int, height: int, fov: float = DEFAULT_FOV) -> Camera:
    """A level camera at the world's origin looking along -z, its longer side spanning `fov` degrees."""
    focal = max(width, height) / 2 / np.tan(np.radians(fov) / 2)
    return Camera(width, height, focal, focal, width / 2, height / 2, np.diag([1.0, -1.0, -1.0, 1.0]))


@dataclasses.dataclass(frozen=True)
class Observations:
    """What C cameras saw in T frames, in undistorted pixels and world axes.

    image: (C, T, 33, 2). visibility: (C, T, 33), 0 out of the picture. world: (C, T, 33, 3) around the hips, world
    axes.
    world_weight: (C, T), 0 where a camera's estimate of depth was rejected.
    """

    image: np.ndarray
    visibility: np.ndarray
    world: np.ndarray
    world_weight: np.ndarray


def torso_frames(points: np.ndarray) -> np.ndarray:
    """(..., 33, 3) points -> (..., 3, 3) the torso's axes as columns: to its left, up, to the front."""
    shoulder_l, shoulder_r, hip_l, hip_r = (points[..., k, :] for k in _TORSO)
    x = (shoulder_l - shoulder_r) + (hip_l - hip_r)
    up = (shoulder_l + shoulder_r) - (hip_l + hip_r)
    y = up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-9)
    x = x - (x * y).sum(-1, keepdims=True) * y
    x = x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-9)
    return np.stack([x, y, np.cross(x, y)], -1)


def _angle(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Angle between rotations (..., 3, 3), radians."""
    trace = np.einsum("...ab,...ab->...", A, B)
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def unflip(world: np.ndarray, seen: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Which reading of each frame gives a person who turns steadily: detectors confuse front and back.

    world: (T, 33, 3) along camera axes. seen: (T,) bool, the torso was seen. Each frame may be read as it is, with
    depth reversed, with left and right exchanged, or both; the cheapest path through time is taken (Viterbi), where
    turning costs its squared angle and another reading costs as much as turning by a quarter.
    Returns depth_reversed and sides_exchanged, (T,) bool.
    """
    readings = [(flip, swap) for flip in (False, True) for swap in (False, True)]
    frames = np.stack([torso_frames(_read_as(world, flip, swap)) for flip, swap in readings], 1)  # (T, 4, 3, 3)
    price = np.array([0.0, 1.0, 1.0, 1.5]) * (np.pi / 2) ** 2
    index = np.flatnonzero(seen)
    chosen = np.zeros(len(world), np.int64)
    if len(index):
        cost, back = price.copy(), []
        for before, now in itertools.pairwise(index):
            # at 10 frames per second a steady turn of a quarter per frame is about the fastest people do
            step = _angle(frames[before][:, None], frames[now][None]) ** 2 * 8 * min(1.0, fps / 10 / (now - before))
            total = cost[:, None] + step
            back.append(total.argmin(0))
            cost = total.min(0) + price
        state = int(cost.argmin())
        for now, links in zip(index[:0:-1], back[::-1], strict=True):
            chosen[now] = state
            state = int(links[state])
        chosen[index[0]] = state
    table = np.array(readings)
    return table[chosen, 0] & seen, table[chosen, 1] & seen


def _read_as(world: np.ndarray, flip: bool, swap: bool) -> np.ndarray:
    points = world[..., MIRROR, :] if swap else world
    return points * np.array([1.0, 1.0, -1.0]) if flip else points


def observe(cameras: list[Camera], landmarks: list[Landmarks], fps: float) -> Observations:
    """Bring the landmarks of all cameras together, flips undone, directions turned into the world."""
    image, visibility, world, weight = [], [], [], []
    for camera, marks in zip(cameras, landmarks, strict=True):
        marks = dataclasses.replace(marks, world=np.einsum("tab,tkb->tka", rays(camera, marks), marks.world))
        seen = marks.visibility[:, _SHOULDERS].min(1) > 0.1
        flipped, swapped = unflip(marks.world, seen, fps)
        order = np.where(swapped[:, None], MIRROR, np.arange(33))
        image.append(np.take_along_axis(marks.image, order[..., None], 1))
        shown = np.where(in_picture(camera, marks.image), marks.visibility, 0)  # of the rest it is a guess
        visibility.append(np.take_along_axis(shown, order, 1))
        points = np.take_along_axis(marks.world, order[..., None], 1)
        world.append(points @ camera.T_camera_world[:3, :3])
        weight.append(1.0 - flipped)
    return Observations(*(np.stack(v) for v in (image, visibility, world, weight)))


def rays(camera: Camera, marks: Landmarks) -> np.ndarray:
    """(T, 3, 3) the rotation that brings the camera's axis onto the ray to the hips: a landmark network sees a crop
    around the person and takes its middle for straight ahead. Identity where the hips were not seen."""
    hips = [INDEX["left_hip"], INDEX["right_hip"]]
    middle = (marks.image[:, hips].mean(1) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    x, y = np.where((marks.visibility[:, hips] > 0).all(1, keepdims=True), middle, 0).T
    ray = np.stack([x, y, np.ones_like(x)], -1) / np.sqrt(1 + x**2 + y**2)[:, None]
    return rotation_between(np.array([0.0, 0.0, 1.0]), ray)


def triangulate(cameras: list[Camera], seen: Observations) -> tuple[np.ndarray, np.ndarray]:
    """(T, 33, 3) points in the world from two or more cameras and (T, 33) their weight, robustly (a camera whose ray
    misses the others' point loses weight, four rounds)."""
    rows = []
    for c, camera in enumerate(cameras):
        P = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]) @ camera.T_camera_world[:3]
        focal = camera.fx
        rows.append(
            np.stack([(seen.image[c][..., i, None] * P[2] - P[i]) / focal for i in (0, 1)], -2)
        )  # (T, 33, 2, 4)
    A = np.stack(rows, 2)  # (T, 33, C, 2, 4)
    base = np.moveaxis(seen.visibility, 0, -1) ** 2
    weight = base.copy()
    for _ in range(4):
        M = np.einsum("tkc,tkcia,tkcib->tkab", weight, A, A)
        M[..., :3, :3] += 1e-9 * np.eye(3)
        points = np.linalg.solve(M[..., :3, :3], -M[..., :3, 3:])[..., 0]
        miss = np.linalg.norm(np.einsum("tkcia,tka->tkci", A[..., :3], points) + A[..., 3], axis=-1)
        weight = base / (1 + (miss / 0.05) ** 2) ** 2
    return points, np.where((base > 0.1).sum(-1) >= 2, weight.sum(-1), 0)


def facing(cameras: list[Camera], seen: Observations, rest: np.ndarray, fps: float) -> np.ndarray:
    """(T, 3, 3) first guess of the body's global orientation in the world, smooth over time.

    rest: (33, 3) the landmarks on the body in its rest pose. From triangulated points where several cameras see the
    torso, else from the world landmarks; frames without either are filled from their neighbours. Shoulders alone say
    it too, less surely. Raises UserError when no frame shows them.
    """
    shoulders, hips = (seen.visibility[:, :, points].min(-1) for points in (_SHOULDERS, _HIPS))
    weight = shoulders * np.maximum(hips, GUESSED_HIPS) * (0.05 + 0.95 * seen.world_weight)
    R = np.einsum("ct,ctab->tab", weight, torso_frames(seen.world))
    total = weight.sum(0)
    if len(cameras) > 1:
        points, certain = triangulate(cameras, seen)
        strong = certain[:, _TORSO].min(1) > 0.5
        R[strong], total[strong] = torso_frames(points[strong]), 1
    sure = total > 0.05
    if not sure.any():
        raise UserError("the landmarks show the shoulders in no frame: nothing to fit a body to")
    R = _nearest_rotation(np.where(sure[:, None, None], R, np.eye(3)))
    return _smoothed(_filled(R, sure), fps) @ torso_frames(rest).T


def _nearest_rotation(M: np.ndarray) -> np.ndarray:
    U, _, Vt = np.linalg.svd(M)
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]
    return U @ Vt


def _filled(R: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Slerp across frames that are not good; the ends repeat the nearest good frame."""
    index, times = np.flatnonzero(good), np.arange(len(R))
    after = np.clip(np.searchsorted(index, times), 0, len(index) - 1)
    before = np.clip(np.searchsorted(index, times, side="right") - 1, 0, len(index) - 1)
    a, b = index[before], index[after]
    fraction = np.where(b > a, (times - a) / np.maximum(b - a, 1), 0.0)
    q = quaternion_from_matrix(R)
    return matrix_from_quaternion(slerp(q[a], q[b], fraction))


def _smoothed(R: np.ndarray, fps: float, seconds: float = 0.08) -> np.ndarray:
    """Gaussian average over time of rotation matrices, brought back to rotations (chordal mean)."""
    times = np.arange(len(R)) / fps
    kernel = np.exp(-0.5 * ((times[:, None] - times[None]) / seconds) ** 2)
    return _nearest_rotation(np.einsum("ts,sab->tab", kernel / kernel.sum(1, keepdims=True), R))


def place(cameras: list[Camera], seen: Observations, points: np.ndarray) -> np.ndarray:
    """(T, 3) translations that bring `points` (T, 33, 3), a turned body at the origin, onto the landmarks.

    Linear least squares of (u Z - X = 0) over head, torso and legs; frames without enough points are interpolated.
    """
    use = np.array([k for name, k in INDEX.items() if not any(p in name for p in ("elbow", "wrist", "pinky", "index",
                    "thumb")) or "foot" in name])  # fmt: skip
    T = points.shape[0]
    A, b = np.zeros((T, 3, 3)), np.zeros((T, 3))
    for c, camera in enumerate(cameras):
        R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
        local = points[:, use] @ R.T + t
        focal = np.array([camera.fx, camera.fy])
        uv = (seen.image[c][:, use] - [camera.cx, camera.cy]) / focal
        w = seen.visibility[c][:, use] ** 2
        for i in (0, 1):
            row = uv[..., i, None] * R[2] - R[i]
            rhs = local[..., i] - uv[..., i] * local[..., 2]
            A += np.einsum("tk,tka,tkb->tab", w, row, row)
            b += np.einsum("tk,tka,tk->ta", w, row, rhs)
    good = np.linalg.eigvalsh(A)[:, 0] > 1e-3
    if not good.any():
        raise UserError("the landmarks show too few points of the person in every frame: nothing to fit a body to")
    trans = np.zeros((T, 3))
    trans[good] = np.linalg.solve(A[good], b[good][..., None])[..., 0]
    index = np.flatnonzero(good)
    return np.stack([np.interp(np.arange(T), index, trans[index, k]) for k in range(3)], -1)
