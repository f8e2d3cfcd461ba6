"""From footage with landmarks and masks to a capture: open, fit, write."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, rotation_between
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

from ..body.skeleton import BodyData
from .coverage import Coverage, covered
from .fit import BodyFitter, Fit, FitOptions
from .footage_source import Source
from .handheld.turning_camera import turning_camera
from .hands.anatomy import has_fingers
from .hands.fit import HandFit, fit_hands
from .initial import DEFAULT_FOV, guess_camera
from .landmarks import Landmarks
from .silhouette import prepare_silhouettes
from .write import CaptureFacts, write_capture

MEETS = 0.15  # most that landmarks may be off, of the size in which they are seen: 0.01 to 0.02 where a body fits


@dataclasses.dataclass(frozen=True)
class Quality:
    """How well the body fits. image_error: (C, T, 33) pixels, NaN where not seen. iou: (C, T). coverage: what of the
    person was seen. hands: how wrists and fingers were fitted, or None on a body without fingers."""

    image_error: np.ndarray
    iou: np.ndarray
    coverage: Coverage = dataclasses.field(default_factory=Coverage)
    hands: HandFit | None = None

    @property
    def notes(self) -> list[str]:
        """What was not seen and so not fitted, sentences for a user."""
        part = self.coverage.sentence()
        return [*([] if part is None else [part]), *([] if self.hands is None else self.hands.sentences())]

    def sentence(self) -> str:
        """All in one line, for a user."""
        seen = self.image_error[np.isfinite(self.image_error)]
        worst = np.unravel_index(self.iou.argmin(), self.iou.shape)
        part = "" if self.coverage.whole else f"{self.coverage.fitted}; "
        return (
            f"{part}landmarks off by {np.median(seen):.1f} px (median), {np.percentile(seen, 95):.1f} px (95 %); "
            f"silhouette IoU {self.iou.mean():.3f} (mean), {self.iou.min():.3f} (worst, frame {worst[1]})"
        )


def fit_and_write(
    source: Source,
    data: BodyData,
    out: Path,
    facts: CaptureFacts,
    *,
    fov: float = DEFAULT_FOV,
    options: FitOptions | None = None,
    overwrite: bool = False,
    preview: bool = True,
    progress: bool = True,
) -> Quality:
    """Fit the body to `source` and write the capture `out`. Raises UserError; nothing is left at `out` then."""
    names = [footage.name for footage in source.footage]
    if facts.holdout_camera is not None and (facts.holdout_camera not in names or len(names) < 2):
        raise UserError(
            f"`holdout_camera={facts.holdout_camera}`: "
            + (f"the cameras are {', '.join(names)}" if len(names) > 1 else "the only camera cannot be held out")
        )
    known = all(footage.lens is not None for footage in source.footage)
    cameras = [(f.camera if known else None) or guess_camera(*f.size, fov) for f in source.footage]
    masks, landmarks = [f.masks() for f in source.footage], [f.landmarks for f in source.footage]
    motion = source.footage[0].motion if len(source.footage) == 1 and not known else None
    turning = None
    if motion is not None:  # the fit sees what a camera that stands still would have seen
        turning = turning_camera(motion, cameras[0])
        cameras, landmarks = [turning.still], [turning.steadied(landmarks[0])]
        masks = [turning.steadied_masks(masks[0])]
    silhouettes = [prepare_silhouettes(m, (c.width, c.height)) for m, c in zip(masks, cameras, strict=True)]
    if options is not None and options.refine_cameras and not known:
        raise UserError("`refine_cameras` is for calibrated cameras, but this camera is unknown: leave it out")
    coverage = covered(cameras, landmarks)
    fit = BodyFitter(data, cameras, landmarks, silhouettes, source.fps, options).run(progress)
    require_meeting(fit, cameras, landmarks)
    if not known:
        fit, cameras = settle(data, fit, cameras)
    cameras = [
        dataclasses.replace(c, cx=c.cx + float(x), cy=c.cy + float(y))
        for c, (x, y) in zip(cameras, fit.shift, strict=True)
    ]
    fit, hands = _with_hands(data, fit, cameras, landmarks, source.fps, coverage)
    moved = Motion(fit.poses, fit.trans, source.fps, fit.betas, facts.name)
    paths = [turning.frames(cameras[0])] if turning is not None else [[camera] for camera in cameras]
    facts = dataclasses.replace(facts, resting=coverage.resting)
    scores = write_capture(out, source, paths, data, moved, facts, overwrite, preview, progress)
    return Quality(fit.image_error, scores, coverage, hands)


def _with_hands(data: BodyData, fit: Fit, cameras: list[Camera], landmarks: list[Landmarks], fps: float,
                coverage: Coverage) -> tuple[Fit, HandFit | None]:  # fmt: skip
    if not has_fingers(data):
        return fit, None
    seen = [marks.hands for marks in landmarks]
    hands = fit_hands(data, cameras, seen, fit.poses, fit.trans, fit.betas, fps, coverage.resting)
    return dataclasses.replace(fit, poses=hands.poses), hands


def require_meeting(fit: Fit, cameras: list[Camera], landmarks: list[Landmarks]) -> None:
    """UserError where the fitted body lies elsewhere than its landmarks."""
    known = np.isfinite(fit.image_error)
    sizes = []
    for c, marks in enumerate(landmarks):
        for points, seen in zip(marks.image, known[c], strict=True):
            if seen.sum() > 1:
                sizes.append(np.linalg.norm(np.ptp(points[seen], axis=0)))
    if not sizes:
        raise UserError("no frame shows enough of the person: film at least head and shoulders")
    off, size = np.median(fit.image_error[known]), np.median(sizes)
    if off > MEETS * size:
        raise UserError(
            f"the body does not fit what was found: its landmarks are off by {off:.0f} pixels on a person of "
            f"{size:.0f} (median); film one person, upright, at least head and shoulders"
        )


def settle(data: BodyData, fit: Fit, cameras: list[Camera]) -> tuple[Fit, list[Camera]]:
    """Turn the world until the fit's `up` is its y, and move it so that the person stands around its origin on the
    floor y = 0. Nothing changes in the images."""
    upright = rotation_between(fit.up, np.array([0.0, 1.0, 0.0]))
    pelvis = data.shaped(fit.betas)[1][0]  # poses turn about it, not about the body's origin
    poses = fit.poses.copy()
    poses[:, 0] = axis_angle_from_matrix(upright @ matrix_from_axis_angle(fit.poses[:, 0]))
    fit = dataclasses.replace(fit, poses=poses, trans=(fit.trans + pelvis) @ upright.T - pelvis, up=upright @ fit.up)
    lowest, middle = [], []
    for poses, trans in zip(fit.poses, fit.trans, strict=True):
        vertices, joints = data.posed(poses, fit.betas, trans)
        lowest.append(vertices[:, 1].min())
        middle.append(joints[0, [0, 2]])
    x, z = np.median(middle, 0)
    shift = -np.array([x, np.median(lowest), z])
    moved = []
    for camera in cameras:
        T = camera.T_camera_world.copy()
        T[:3, :3] = T[:3, :3] @ upright.T
        T[:3, 3] -= T[:3, :3] @ shift
        moved.append(dataclasses.replace(camera, T_camera_world=T))
    return dataclasses.replace(fit, trans=fit.trans + shift), moved
