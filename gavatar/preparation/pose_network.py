"""MediaPipe's BlazePose networks run by ONNX Runtime: where people are, their 33 landmarks, their outline.

The two networks are MediaPipe's own (Apache-2.0), converted by tools/convert_tflite.py; what surrounds them (anchors,
crops, refinement) follows the published graphs of mediapipe/modules/pose_detection and pose_landmark. Source:
Bazarevsky et al., "BlazePose: On-device Real-time Body Pose tracking", 2020.
"""

from __future__ import annotations

import dataclasses
from importlib.resources import as_file, files
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from gavatar_runtime.decoding.network import session_options
from gavatar_runtime.errors import UserError

from .landmarks import MIRROR

DETECTOR_SIDE, CROP_SIDE = 224, 256
_STRIDES = ((8, 2), (16, 2), (32, 6))  # pixels between two places of the grid, anchors at each place
SCORE, OVERLAP = 0.5, 0.3  # of the detector's graph: least score, overlap above which two boxes are one person
ROI_SCALE = 1.25
_CENTRE, _RIM = 33, 34  # auxiliary points: the hips' centre and a point on the circle around the whole person


@dataclasses.dataclass(frozen=True)
class Region:
    """A square in the image that shows a person upright: centre (x, y) and side in pixels, angle in radians
    (clockwise on the screen; 0 when the person stands upright in the image)."""

    centre: np.ndarray
    side: float
    angle: float

    @staticmethod
    def around(centre: np.ndarray, rim: np.ndarray) -> Region:
        """The region of the circle around `centre` (hips) through `rim` (a point straight above it on the person)."""
        dx, dy = np.asarray(rim, np.float64) - centre
        angle = np.pi / 2 - np.arctan2(-dy, dx)
        angle -= 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))
        return Region(np.asarray(centre, np.float64), 2 * ROI_SCALE * float(np.hypot(dx, dy)), float(angle))

    def to_image(self, size: int = CROP_SIDE) -> np.ndarray:
        """(2, 3) affine map from continuous pixels of the crop to those of the image."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        A = np.array([[c, -s], [s, c]]) * (self.side / size)
        return np.c_[A, self.centre - A @ [size / 2, size / 2]]

    def crop(self, image: np.ndarray, size: int = CROP_SIDE) -> np.ndarray:
        """(size, size, ...) of the image; black outside it."""
        shrink = self.side / size
        if shrink > 2:  # bilinear samples would skip pixels
            image = cv2.blur(image, (int(shrink), int(shrink)))
        M = _corner_to_centre(self.to_image(size))
        return cv2.warpAffine(image, M, (size, size), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)

    def paste(self, crop: np.ndarray, width: int, height: int) -> np.ndarray:
        """(height, width) float32: a map of the crop, (size, size), laid back over the image; 0 outside the region."""
        M = _corner_to_centre(self.to_image(len(crop)))
        return cv2.warpAffine(crop, M, (width, height), flags=cv2.INTER_CUBIC if len(crop) < self.side else
                              cv2.INTER_AREA)  # fmt: skip


def _corner_to_centre(M: np.ndarray) -> np.ndarray:
    """An affine map of continuous pixels (centres at +0.5) as one of cv2's (centres at whole numbers)."""
    M = M.copy()
    M[:, 2] += M[:, :2] @ [0.5, 0.5] - 0.5
    return M


@dataclasses.dataclass(frozen=True)
class TrackedPerson:
    """One detected person. box: x0, y0, x1, y1 of the face and shoulders, pixels. region: the whole body's."""

    score: float
    box: np.ndarray
    region: Region


@dataclasses.dataclass(frozen=True)
class Pose:
    """The network's answer for one region. score: in [0, 1], whether a person is there. image: (33, 3) pixels x, y and
    depth relative to the hips in pixels. visibility: (33,). world: (33, 3) metres around the hips along camera axes.
    outline: (256, 256) probability that a pixel of the crop is the person. region: where that crop lies;
    following: where to look in the next frame."""

    score: float
    image: np.ndarray
    visibility: np.ndarray
    world: np.ndarray
    outline: np.ndarray
    region: Region
    following: Region


def anchors() -> np.ndarray:
    """(2254, 2) centres of the detector's anchors, in units of its input's side; all have size 1."""
    places = []
    for stride, count in _STRIDES:
        n = DETECTOR_SIDE // stride
        axis = (np.arange(n) + 0.5) / n
        grid = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
        places.append(np.repeat(grid, count, 0))
    return np.concatenate(places)


def sigmoid(values: np.ndarray) -> np.ndarray:
    """Logistic function that overflows for no input."""
    return 0.5 * (1 + np.tanh(0.5 * np.asarray(values, np.float64)))


def merge_overlapping(boxes: np.ndarray, scores: np.ndarray, overlap: float = OVERLAP) -> list[np.ndarray]:
    """Groups of indices, best first: each box with those that overlap it by more than `overlap` (IoU).

    boxes: (N, 4) x0, y0, x1, y1.
    """
    groups, left = [], np.argsort(-scores, kind="stable")
    while len(left):
        best, rest = boxes[left[0]], boxes[left]
        inner = np.minimum(best[2:], rest[:, 2:]) - np.maximum(best[:2], rest[:, :2])
        common = np.prod(np.maximum(inner, 0), -1)
        area = np.prod(rest[:, 2:] - rest[:, :2], -1)
        same = common / np.maximum(area + np.prod(best[2:] - best[:2]) - common, 1e-9) > overlap
        same[0] = True
        groups.append(left[same])
        left = left[~same]
    return groups


def open_network(path: Path) -> onnxruntime.InferenceSession:
    """The network in an ONNX file, ready to run. Raises UserError for a file that holds none."""
    try:
        return onnxruntime.InferenceSession(str(path), session_options(), providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime's own error classes differ from version to version
        raise UserError(f"{path} cannot be read as an ONNX network: {error}") from None


class PoseNetworks:
    """The person detector and the landmark network, loaded once."""

    def __init__(self, landmark_file: Path | None = None):
        """landmark_file: another landmark network with the same inputs and outputs, such as MediaPipe's heavy one."""
        with as_file(files("gavatar.data") / "pose") as folder:
            self.detector = open_network(folder / "pose_detection.onnx")
            self.landmarker = open_network(landmark_file or folder / "pose_landmark_full.onnx")
        self.anchors = anchors()

    def detect(self, image: np.ndarray) -> list[TrackedPerson]:
        """People in an image (H, W, 3) uint8 BGR, most certain first."""
        height, width = image.shape[:2]
        whole = Region(np.array([width / 2, height / 2]), float(max(width, height)), 0.0)
        x = whole.crop(image, DETECTOR_SIDE)[..., ::-1].astype(np.float32) / 127.5 - 1
        raw, logits = self.detector.run(None, {"image": x[None]})
        scores = sigmoid(logits[0, :, 0])
        chosen = np.flatnonzero(scores > SCORE)
        if not len(chosen):
            return []
        raw, scores = raw[0, chosen].astype(np.float64) / DETECTOR_SIDE, scores[chosen]
        raw[:, :2] += self.anchors[chosen]
        points = raw[:, 4:].reshape(-1, 4, 2) + self.anchors[chosen, None]
        boxes = np.concatenate([raw[:, :2] - raw[:, 2:4] / 2, raw[:, :2] + raw[:, 2:4] / 2], -1)
        people = []
        M = whole.to_image(1)
        for group in merge_overlapping(boxes, scores):
            weight = scores[group] / scores[group].sum()
            box = (weight @ boxes[group]).reshape(2, 2) @ M[:, :2].T + M[:, 2]
            centre, rim = np.einsum("n,nkc->kc", weight, points[group])[:2] @ M[:, :2].T + M[:, 2]
            people.append(TrackedPerson(float(scores[group].max()), box.reshape(4), Region.around(centre, rim)))
        return people

    def landmarks(self, image: np.ndarray, region: Region, mirrored: bool = True) -> Pose:
        """The pose in `region` of an image (H, W, 3) uint8 BGR.

        mirrored: also ask about the mirror image and average, which halves the work's speed and lessens its noise.
        """
        crop = region.crop(image)[..., ::-1].astype(np.float32) / 255
        points, world, outline, score = self._ask(crop)
        if mirrored:
            other_points, other_world, other_outline, other_score = self._ask(np.ascontiguousarray(crop[:, ::-1]))
            order = np.r_[MIRROR, np.arange(33, 39)]
            other_points, other_world = other_points[order], other_world[order]
            other_points[:, 0] = CROP_SIDE - other_points[:, 0]
            other_world[:, 0] *= -1
            # the visibilities are averaged as logits
            points, world = 0.5 * (points + other_points), 0.5 * (world + other_world)
            outline, score = 0.5 * (outline + other_outline[:, ::-1]), 0.5 * (score + other_score)
        M = region.to_image()
        flat = points[:, :2] @ M[:, :2].T + M[:, 2]
        depth = points[:33, 2:3] * (region.side / CROP_SIDE)
        c, s = np.cos(region.angle), np.sin(region.angle)
        world = world[:33] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        following = Region.around(flat[_CENTRE], flat[_RIM])
        return Pose(float(score), np.c_[flat[:33], depth], sigmoid(points[:33, 3]), world, sigmoid(outline), region,
                    following)  # fmt: skip

    def _ask(self, crop: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """points (39, 5) x, y, z in crop pixels and two logits, world (39, 3), outline logits (256, 256), score."""
        points, score, outline, heat, world = self.landmarker.run(None, {"image": crop[None]})
        points = points.reshape(39, 5).astype(np.float64)
        points[:, :2] = refine(points[:, :2], heat[0])
        return points, world.reshape(39, 3).astype(np.float64), outline[0, ..., 0], float(score[0, 0])


def refine(points: np.ndarray, heat: np.ndarray, reach: int = 3, least: float = 0.5) -> np.ndarray:
    """(39, 2) crop pixels moved to the centre of mass of their heat map (h, w, 39) logits within `reach` cells, where
    it rises above `least` (the refinement of the published graph, kernel 7)."""
    h, w, _ = heat.shape
    refined = points.copy()
    cell = CROP_SIDE / w
    for k, (x, y) in enumerate(points):
        i, j = int(y / cell), int(x / cell)
        if not (0 <= i < h and 0 <= j < w):
            continue
        rows, columns = slice(max(0, i - reach), i + reach + 1), slice(max(0, j - reach), j + reach + 1)
        part = sigmoid(heat[rows, columns, k])
        if part.max() >= least:
            ys, xs = np.mgrid[rows.start : rows.start + part.shape[0], columns.start : columns.start + part.shape[1]]
            refined[k] = [(part * xs).sum() * cell / part.sum(), (part * ys).sum() * cell / part.sum()]
    return refined
