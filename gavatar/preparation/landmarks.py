"""MediaPipe's 33 body landmarks: reading them, and where they sit on a body of the SMPL family."""

from __future__ import annotations

import dataclasses
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.values.body import SMPL_BODY_JOINTS, BodyData

from .hands.hand_files import read_hands
from .hands.landmarks import HandLandmarks, pixels_per_metre

NAMES = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index", "left_thumb",
    "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel",
    "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
INDEX = {name: k for k, name in enumerate(NAMES)}


def _mirrored(name: str) -> str:
    if name.startswith("mouth"):
        return "mouth_right" if name == "mouth_left" else "mouth_left"
    if name.startswith("left_"):
        return name.replace("left_", "right_", 1)
    return name.replace("right_", "left_", 1)


MIRROR = np.array([INDEX[_mirrored(name)] for name in NAMES])  # the same point of the body's other side

# Straight pieces of the body between two landmarks, whose directions in space MediaPipe estimates.
_LIMBS = (
    ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("heel", "foot_index"),
    ("hip", "shoulder"), ("pinky", "index"),
)  # fmt: skip
BONES = (
    *((INDEX[f"{side}_{a}"], INDEX[f"{side}_{b}"]) for side in ("left", "right") for a, b in _LIMBS),
    *((INDEX[f"{side}_ear"], INDEX["nose"]) for side in ("left", "right")),
    *((INDEX[f"right_{part}"], INDEX[f"left_{part}"]) for part in ("shoulder", "hip", "ear")),
)

# Points that are joints of the SMPL family. A finger's knuckle moves with the wrist: fingers stay at rest.
_JOINTS = {
    "shoulder": "shoulder", "elbow": "elbow", "wrist": "wrist", "hip": "hip", "knee": "knee", "ankle": "ankle",
    "pinky": "pinky1", "index": "index1", "thumb": "thumb3",
}  # fmt: skip
# Points on the head of the T-pose, from the head joint to the point, in units of the way from that joint up to the
# crown (0.21 m for the free body); measured on pictures of it. The nearest vertex is taken.
_FACE = {
    "nose": (0.0, 0.25, 0.72), "eye_inner": (0.075, 0.43, 0.55), "eye": (0.15, 0.44, 0.54),
    "eye_outer": (0.225, 0.43, 0.48), "ear": (0.415, 0.33, 0.13), "mouth": (0.1, 0.09, 0.62),
}  # fmt: skip

# How far a point MediaPipe marks may sit from ours, the same way in every frame (standard deviation, metres). Its hip
# and shoulder are no SMPL joints; the foot's points include the shoe.
OFFSET_SIGMA = np.full(33, 0.015)
for _name in ("shoulder", "hip"):
    OFFSET_SIGMA[[INDEX[f"left_{_name}"], INDEX[f"right_{_name}"]]] = 0.04
for _name in ("heel", "foot_index", "ankle", "elbow", "knee", "pinky", "index", "thumb"):
    OFFSET_SIGMA[[INDEX[f"left_{_name}"], INDEX[f"right_{_name}"]]] = 0.025


@dataclasses.dataclass(frozen=True)
class Landmarks:
    """What a landmark detector saw of one camera's T frames.

    image: (T, 33, 2) pixels, continuous (the pixel of column j is centred at j + 0.5). visibility: (T, 33) in [0, 1];
    0 = not seen, and then the other numbers mean nothing (they are set to zero). world: (T, 33, 3) metres around the
    hips' centre, along the camera's axes (x right, y down, z away). fps: frames per second or None.
    width, height: pixels of the image the points were found in, or None. hands: the 21 points of each hand, or None.
    """

    image: np.ndarray
    visibility: np.ndarray
    world: np.ndarray
    fps: float | None = None
    width: int | None = None
    height: int | None = None
    hands: HandLandmarks | None = None

    def __len__(self) -> int:
        return len(self.image)

    def __getitem__(self, frames: slice | np.ndarray) -> Landmarks:
        hands = None if self.hands is None else self.hands[frames]
        return dataclasses.replace(
            self, image=self.image[frames], visibility=self.visibility[frames], world=self.world[frames], hands=hands
        )

    def moved(self, undistorted: Callable[[np.ndarray], np.ndarray] | None, size: tuple[int, int],
              filmed: tuple[int, int]) -> Landmarks:  # fmt: skip
        """In pixels of an image of `size` (width, height) instead of the one that was `filmed`. undistorted: takes
        filmed pixels (..., 2) to those without the lens' distortion."""
        factor = np.array(size) / filmed

        def move(points: np.ndarray) -> np.ndarray:
            return (points if undistorted is None else undistorted(points)) * factor

        hands = self.hands
        if hands is not None:
            hands = HandLandmarks(move(hands.image), hands.world, hands.weight, hands.size * float(factor.mean()))
        return dataclasses.replace(self, image=move(self.image), width=size[0], height=size[1], hands=hands)


def read_landmarks(path: str | os.PathLike) -> Landmarks:
    """Read a landmarks .npz: `image` and `world` (T, 33, 4), x y z visibility, `fps`, `width`, `height` where known,
    and points of hands where there are any (`hands.hand_files.read_hands`).

    Raises UserError, naming file and field, for an unreadable file, another number of points, NaN in a point that
    counts as seen, or image coordinates that are plainly normalised instead of pixels.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except FileNotFoundError:
        raise UserError(f"{path} is missing: give `landmarks`") from None
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise UserError(f"{path} cannot be read as .npz landmarks: {error}") from None
    points = {}
    for key in ("image", "world"):
        if key not in arrays:
            raise UserError(f"{path} has no array '{key}': landmarks hold 'image' and 'world', each (T, 33, 4)")
        points[key] = value = arrays[key]
        if value.ndim != 3 or value.shape[1:] != (33, 4) or value.dtype.kind not in "fiu":
            raise UserError(
                f"{path}: '{key}' has shape {value.shape}, but MediaPipe's points need (T, 33, 4): x, y, z, visibility"
            )
    if len(points["image"]) != len(points["world"]) or not len(points["image"]):
        raise UserError(
            f"{path}: 'image' has {len(points['image'])} frames and 'world' {len(points['world'])}; "
            "both need the same number, at least 1"
        )
    visibility = points["image"][..., 3].astype(np.float64)
    if not np.isfinite(visibility).all():
        frame = int(np.argwhere(~np.isfinite(visibility))[0, 0])
        raise UserError(f"{path}: 'image' has NaN visibility in frame {frame}; write visibility 0 for unseen points")
    visibility = np.clip(visibility, 0, 1)
    for key, value in points.items():
        bad = ~np.isfinite(value[..., :3]).all(-1) & (visibility > 0)
        if bad.any():
            frame, point = np.argwhere(bad)[0]
            raise UserError(
                f"{path}: '{key}' has NaN in frame {frame}, point {point} ({NAMES[point]}), which counts as seen; "
                "write visibility 0 for unseen points"
            )
    seen = visibility[..., None] > 0
    image = np.where(seen, points["image"][..., :2], 0).astype(np.float64)
    size = [_scalar(path, arrays, key) for key in ("fps", "width", "height")]
    if seen.any() and np.abs(image).max() <= 2 and (size[1] or 512) > 8:
        raise UserError(f"{path}: 'image' looks normalised (all within 2); give pixels: multiply by width and height")
    world = np.where(seen, points["world"][..., :3], 0).astype(np.float64)
    return Landmarks(
        image=image,
        visibility=visibility,
        world=world,
        hands=read_hands(path, arrays, pixels_per_metre(image, world, seen[..., 0])),
        fps=size[0],
        width=None if size[1] is None else int(size[1]),
        height=None if size[2] is None else int(size[2]),
    )


def _scalar(path: Path, arrays: dict, key: str) -> float | None:
    if key not in arrays:
        return None
    value = np.asarray(arrays[key]).reshape(-1)
    if value.size != 1 or value.dtype.kind not in "fiu" or not (np.isfinite(value[0]) and value[0] > 0):
        raise UserError(f"{path}: '{key}' must be one positive number")
    return float(value[0])


def landmark_rows(data: BodyData) -> tuple[np.ndarray, np.ndarray]:
    """Where the 33 points sit on a body.

    Returns a regressor (33, V), points = regressor @ rest vertices, and skinning weights (33, J) of those points.
    The body's rest pose must be a T-pose facing +z with y up. On a body without finger joints the
    hand's points sit at SMPL's hand joint, or else at its wrist.
    """
    regressor = np.zeros((33, len(data.v_template)))
    weights = np.zeros((33, data.num_joints))
    joint = {name: k for k, name in enumerate(data.joint_names)}
    rest = data.J_regressor @ data.v_template
    head = rest[joint["head"]]
    unit = data.v_template[:, 1].max() - head[1]
    ankles = np.zeros((len(data.v_template), 2), bool)
    for column, side in enumerate(("left", "right")):
        feet = [joint[f"{side}_ankle"], joint[f"{side}_foot"]]
        ankles[:, column] = data.lbs_weights[:, feet].sum(-1) > 0.5
    for k, name in enumerate(NAMES):
        side = next((s for s in ("left", "right") if s in name), "")
        part = name.replace("mouth_left", "mouth").replace("mouth_right", "mouth").replace(f"{side}_", "", 1)
        if part in _FACE:
            place = head + unit * np.array(_FACE[part]) * ([-1, 1, 1] if side == "right" else [1, 1, 1])
            _one_vertex(data, regressor, weights, k, int(np.linalg.norm(data.v_template - place, axis=1).argmin()))
        elif part in ("heel", "foot_index"):
            foot = np.flatnonzero(ankles[:, 0 if side == "left" else 1])
            z = data.v_template[foot, 2]
            _one_vertex(data, regressor, weights, k, int(foot[z.argmin() if part == "heel" else z.argmax()]))
        else:
            hand = joint.get(f"{side}_hand", joint[f"{side}_wrist"])
            j = joint.get(f"{side}_{_JOINTS[part]}", hand)
            regressor[k] = data.J_regressor[j]
            weights[k, j] = 1
    return regressor, weights


def _one_vertex(data: BodyData, regressor: np.ndarray, weights: np.ndarray, row: int, vertex: int) -> None:
    regressor[row, vertex] = 1
    weights[row] = data.lbs_weights[vertex]


def fold_hands(weights: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """(N, J) skinning weights -> (N, 22): what hangs on a finger hangs on its wrist, exact while fingers rest."""
    folded = weights[:, :SMPL_BODY_JOINTS].copy()
    for j in range(SMPL_BODY_JOINTS, weights.shape[1]):
        k = int(parents[j])
        while k >= SMPL_BODY_JOINTS:
            k = int(parents[k])
        folded[:, k] += weights[:, j]
    return folded
