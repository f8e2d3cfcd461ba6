"""A camera that turns and zooms on the spot: its pose in every frame, and everything seen as one camera that stands
still would have seen it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

import cv2
import numpy as np
from scipy.optimize import least_squares

from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from gavatar_runtime.values.camera import Camera

from ..coverage import in_picture
from ..hands.landmarks import HandLandmarks
from ..landmarks import Landmarks
from .room_motion import RoomMotion

WIDEST = 3.0  # times the picture's side: the most that the still camera is made to see


@dataclasses.dataclass(frozen=True)
class TurningCamera:
    """still: a camera at the reference frame's pose that sees all that any frame saw. rotations: (T, 3, 3) from its
    axes to those of each frame. focal: (T,) pixels. size, centre: of the frames, (width, height) and (cx, cy)."""

    still: Camera
    rotations: np.ndarray
    focal: np.ndarray
    size: tuple[int, int]
    centre: tuple[float, float]

    def frames(self, still: Camera) -> list[Camera]:
        """The camera of each frame, where the still one is `still` in the world."""
        cameras = []
        for R, focal in zip(self.rotations, self.focal, strict=True):
            T = still.T_camera_world.copy()
            T[:3] = R @ T[:3]
            cameras.append(Camera(*self.size, float(focal), float(focal), *self.centre, T))
        return cameras

    def homographies(self) -> np.ndarray:
        """(T, 3, 3) from pixels of each frame to those of the still camera."""
        back = np.linalg.inv([_matrix(f, self.centre) for f in self.focal])
        K = _matrix(self.still.fx, (self.still.cx, self.still.cy))
        result: np.ndarray = K @ self.rotations.transpose(0, 2, 1) @ back
        return result

    def steadied(self, marks: Landmarks) -> Landmarks:
        """Landmarks as the still camera sees them; what lay out of a frame's picture is not seen."""
        H, frame = self.homographies(), Camera(*self.size, 1.0, 1.0, *self.centre, np.eye(4))
        points = np.einsum("tab,tkb->tka", H, np.concatenate([marks.image, np.ones_like(marks.image[..., :1])], -1))
        image = points[..., :2] / np.maximum(points[..., 2:], 1e-6)
        roll = np.arctan2(self.rotations[:, 1, 0], self.rotations[:, 0, 0])  # a network's axes follow the picture's
        c, s = np.cos(roll), np.sin(roll)
        turn = np.moveaxis(np.array([[c, s, 0 * c], [-s, c, 0 * c], [0 * c, 0 * c, 0 * c + 1]]), -1, 0)
        hands = marks.hands
        if hands is not None:
            seen = np.concatenate([hands.image, np.ones_like(hands.image[..., :1])], -1)
            seen = np.einsum("tab,thkb->thka", H, seen)
            hands = HandLandmarks(
                seen[..., :2] / np.maximum(seen[..., 2:], 1e-6), np.einsum("tab,thkb->thka", turn, hands.world),
                hands.weight, hands.size,
            )  # fmt: skip
        return dataclasses.replace(
            marks, image=image, world=np.einsum("tab,tkb->tka", turn, marks.world), hands=hands,
            visibility=np.where(in_picture(frame, marks.image), marks.visibility, 0), width=self.still.width,
            height=self.still.height,
        )  # fmt: skip

    def steadied_masks(self, masks: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """Masks as the still camera sees them, nothing beside the frames."""
        shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])  # cv2 counts from pixel centres
        for mask, H in zip(masks, self.homographies(), strict=True):
            size = self.still.width, self.still.height
            yield cv2.warpPerspective(mask, np.linalg.inv(shift) @ H @ shift, size, flags=cv2.INTER_LINEAR)


def _matrix(focal: float, centre: tuple[float, float]) -> np.ndarray:
    return np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])


def turning_camera(motion: RoomMotion, guess: Camera) -> TurningCamera:
    """The rotation and the focal length of each frame that explain how the room moved. guess: the camera of the
    reference frame; one that stands elsewhere is taken for one that turned."""
    size, centre = (guess.width, guess.height), (guess.cx, guess.cy)
    x, y = np.meshgrid(np.linspace(0.05, 0.95, 5) * size[0], np.linspace(0.05, 0.95, 5) * size[1])
    grid = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    rays = grid @ np.linalg.inv(_matrix(guess.fx, centre)).T
    values, start = np.zeros((len(motion.to_frame), 4)), np.zeros(4)
    order = np.argsort(np.abs(np.arange(len(values)) - motion.reference), kind="stable")
    for t in order:
        there = grid @ motion.to_frame[t].T
        there = there[:, :2] / there[:, 2:]
        beside = int(np.clip(t + np.sign(motion.reference - t), 0, len(values) - 1))
        start = values[beside]  # of the neighbour nearer to the reference, which came before

        def miss(value: np.ndarray, there: np.ndarray = there) -> np.ndarray:
            seen = rays @ matrix_from_axis_angle(value[:3]).T
            pixels = guess.fx * np.exp(value[3]) * seen[:, :2] / np.maximum(seen[:, 2:], 1e-3) + centre
            return (pixels - there).ravel()

        values[t] = least_squares(miss, start, method="lm" if t != motion.reference else "trf", max_nfev=60).x
    rotations = matrix_from_axis_angle(values[:, :3])
    focal = guess.fx * np.exp(values[:, 3])
    camera = TurningCamera(guess, rotations, focal, size, centre)
    return dataclasses.replace(camera, still=_seeing_all(camera, guess))


def _seeing_all(camera: TurningCamera, guess: Camera) -> Camera:
    """The reference camera with a picture large enough for what every frame saw."""
    w, h = camera.size
    corners = np.array([[0, 0, 1], [w, 0, 1], [0, h, 1], [w, h, 1.0]])
    points = np.einsum("tab,kb->tka", camera.homographies(), corners)
    flat = (points[..., :2] / np.maximum(points[..., 2:], 1e-3)).reshape(-1, 2)
    low = np.maximum(np.floor(flat.min(0)), [-WIDEST * w, -WIDEST * h])
    high = np.minimum(np.ceil(flat.max(0)), [WIDEST * w, WIDEST * h])
    width, height = (high - low).astype(int)
    return dataclasses.replace(guess, width=int(width), height=int(height), cx=guess.cx - low[0], cy=guess.cy - low[1])


def turned_by(rotations: np.ndarray) -> float:
    """The largest angle between two frames' cameras, from the reference, degrees."""
    return float(np.degrees(np.linalg.norm(axis_angle_from_matrix(rotations), axis=-1).max()))
