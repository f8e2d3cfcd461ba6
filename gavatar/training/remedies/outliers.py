"""Estimates that are plainly wrong for a few frames (left and right exchanged, a jump), put right from the frames
around them, before training bends the avatar to them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ...avatar.trainable import Pose
from ...body.torch_rotations import matrix_from_axis_angle, rotation_vector_from_matrix
from ..motion_table import MotionTable
from ..scene import Scene

# seconds to the nearest neighbours that are believed: those next to the frame, or beyond a run of wrong ones
REACHES = (0.0, 0.2, 0.4)
# times the median error of the frames within so many seconds, or of all. On a clean capture frames of a fast turn reach
# 1.9, and a pose from their neighbours renders better and is worse; planted faults that harm begin at 4
STANDS_OUT, AROUND = 2.5, 1.0
LOOKED_AT = 128  # pixels of the longer side that are enough to tell a wrong pose
WORTH = 0.85  # a pose from the neighbours is taken if its error is at most this share of the error of the frame's own


Poses = dict[int, Pose]  # one by frame


@torch.no_grad()
def between(table: MotionTable, frames: list[int], reach: float) -> Poses:
    """The pose that the refined motion has halfway, in time, between a frame's neighbours.

    frames: those that may serve as neighbours, ascending. reach: seconds; a neighbour is the nearest frame further away
    than that. Frames without a neighbour on either side are left out. Rotations turn at a steady rate, the translation
    moves along the line; all else is the frame's own.
    """
    times = np.array(frames) / table.fps
    refined = table(frames)
    rotations, trans = refined.rotations, refined.trans
    found = {}
    for i, frame in enumerate(frames):
        earlier, later = np.flatnonzero(times < times[i] - reach), np.flatnonzero(times > times[i] + reach)
        if not (len(earlier) and len(later)):
            continue
        a, b = int(earlier[-1]), int(later[0])
        share = float((times[i] - times[a]) / (times[b] - times[a]))
        turn = rotation_vector_from_matrix(rotations[a].mT @ rotations[b])
        found[frame] = dataclasses.replace(
            refined[i : i + 1],
            rotations=(rotations[a] @ matrix_from_axis_angle(share * turn))[None],
            trans=torch.lerp(trans[a], trans[b], share)[None],
        )
    return found


def other_side(name: str, names: Sequence[str]) -> str:
    """That of the joints `names` on the person's other side, the joint itself where there is none."""
    for side, other in (("left_", "right_"), ("right_", "left_")):
        if name.startswith(side) and other + name.removeprefix(side) in names:
            return other + name.removeprefix(side)
    return name


def exchanged(rotations: Tensor, names: Sequence[str]) -> Tensor:
    """Local rotations (..., J, 3, 3) with left and right exchanged: the pose in a mirror (x is to the left), the
    root as it was. names: of the joints."""
    partner = [names.index(other_side(name, names)) for name in names]
    mirror = torch.diag(rotations.new_tensor([-1.0, 1, 1]))
    out = mirror @ rotations[..., partner, :, :] @ mirror
    out[..., 0, :, :] = rotations[..., 0, :, :]
    return out


KINDS = ("drawn along", "displaced", "exchanged", "out of line")  # what is wrong with a frame, as `candidates` go


def candidates(table: MotionTable, frames: list[int], names: Sequence[str]) -> list[list[Poses]]:
    """What may be right of each frame where the refined pose is not, in the kinds KINDS that change more and more: the
    estimate, where wrong neighbours have drawn it along; the root put between its neighbours; the estimate with left
    and right exchanged; the whole pose put between its neighbours."""
    estimate = {frame: table.estimated([frame]) for frame in frames}
    spans = [between(table, frames, reach) for reach in REACHES]
    moved = [{f: dataclasses.replace(table([f]), trans=pose.trans) for f, pose in span.items()} for span in spans]
    swapped = {f: dataclasses.replace(p, rotations=exchanged(p.rotations, names)) for f, p in estimate.items()}
    return [[estimate], moved, [swapped], spans]


def suspects(times: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(F,) bool: the frames that render worse than those around them or than all usually do; no other pose renders the
    rest better by far. times: (F,) seconds. errors: (F,) mean squared."""
    around = [np.median(errors[np.abs(times - at) <= AROUND]) for at in times]
    return errors > STANDS_OUT * np.minimum(around, np.median(errors))


def judging_scale(scene: Scene, image: float) -> float:
    """The scale at most `image` at which pictures are as small as tells a wrong pose."""
    side = max(max(camera.width, camera.height) for camera in map(scene.footage.capture.camera, scene.views))
    return min(image, max(image / 2, LOOKED_AT / side))


@torch.no_grad()
def mend_outliers(scene: Scene, image: float) -> dict[str, list[int]]:
    """Give frames whose images speak plainly for another of the `candidates` that pose; returns those frames by what
    was wrong with them, one of KINDS.

    image: scale of the images that judge, smaller where that is enough. Only `suspects` are tried. Of one kind the pose
    that renders best counts, and it must be better by far than the frame's own or than one that changes less. It is a
    correction of the estimate like any other, free to be refined.
    """
    table, frames = scene.motion, scene.frames
    shown = np.array([view.frame for view in scene.views])

    def errors(poses: Poses) -> np.ndarray:
        """(F,) by frame, infinite where `poses` has none."""
        rows = [row for row, frame in enumerate(shown) if frame in poses]
        by_view = scene.errors(rows, image, poses=poses.__getitem__)
        return np.array([by_view[shown[rows] == f].mean() if f in poses else np.inf for f in frames])

    image = judging_scale(scene, image)
    best = errors({frame: table([frame]) for frame in frames})
    tried = {frames[i] for i in np.flatnonzero(suspects(np.array(frames) / table.fps, best))}
    mended: Poses = {}
    wrong: dict[int, str] = {}
    kinds = candidates(table, frames, list(scene.built.body.data.joint_names)) if tried else []
    for name, kind in zip(KINDS, kinds, strict=False):
        scores = np.array([errors({f: pose for f, pose in poses.items() if f in tried}) for poses in kind])
        chosen = scores.argmin(0)
        for i in np.flatnonzero(scores.min(0) <= WORTH * best):
            frame = frames[i]
            mended[frame], best[i], wrong[frame] = kind[chosen[i]][frame], scores[chosen[i], i], name
    for frame, pose in mended.items():
        turn = table.initial_rotations[frame, : table.joints].mT @ pose.rotations[0, : table.joints]
        table.rotation_correction[frame] = rotation_vector_from_matrix(turn)
        table.trans_correction[frame] = pose.trans[0] - table.initial_trans[frame]
    scene.moved(list(mended))
    return {name: sorted(frame for frame in wrong if wrong[frame] == name) for name in KINDS}
