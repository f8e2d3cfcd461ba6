"""Do the body and the masks meet? A coarse look at a few frames, which finds what a training could never mend."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import cv2
import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.kinematics import invert_rigid, joint_transforms
from gavatar_runtime.motions.upright import Y_UP_FROM
from gavatar_runtime.values.body import SMPL_BODY_JOINTS, BodyData, check_motion_fits
from gavatar_runtime.values.camera import Camera

from .capture import Capture, View

SAMPLE = 12  # views that are looked at, spread evenly
SIDE = 128  # pixels of the longer side of what is compared
LIMB = 0.16  # metres across: a person's silhouette drawn as thick bones
HEAD = 0.12  # metres: radius
APART = 0.05  # overlap (intersection over union) below which a body and a mask do not meet
MOST = 0.75  # share of the views that have to be so
POOR = 0.3  # median overlap below which another reading of the numbers is looked for
MEET = 0.45  # median overlap by which one explains the masks; sound captures have 0.57 and more
OFFSETS = (-1, 1, -2, 2, -3, 3, -4, 4, -5, 5)  # frames
_HEAD = 15  # of SMPL's joints
OPENGL = np.diag([1.0, -1, -1, 1])

Place = Callable[[View], tuple[np.ndarray, Camera]]


@dataclasses.dataclass
class _Bones:
    """The skeleton of the motion: where its joints are, (T, J, 3) in the world, and their parents."""

    joints: np.ndarray
    parents: np.ndarray


def apart(capture: Capture, body: BodyData, views: list[View]) -> str | None:
    """A sentence when the posed body stands clearly elsewhere than the masks' person in most of a sample of `views`,
    with the likely cause where another reading of the numbers makes them meet; None otherwise, also where nothing can
    be compared. capture: its motion placed on `body`, whose first joints are SMPL's."""
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, SAMPLE).astype(int))] if views else []
    masks = _masks(capture, chosen)
    if not masks or 2 * len(masks) < len(chosen) or body.num_joints < SMPL_BODY_JOINTS:
        return None
    bones = _bones(capture, body)
    overlaps = _overlaps(masks, lambda view: (bones.joints[view.frame], capture.camera(view)), bones.parents)
    bad = int((overlaps < APART).sum())
    if bad < MOST * len(masks) and np.median(overlaps) > POOR:
        return None
    likely = _likely(capture, bones, masks)
    if bad < MOST * len(masks):
        if likely is None:
            return None
        what = f"meet badly (overlap {np.median(overlaps):.2f} of 1"
    else:
        what = f"do not meet (in {bad} of {len(masks)} views looked at"
    likely = likely or "look at the axes and units of poses and cameras, and at which frame is which"
    return f"{capture.path}: the posed body and the masks {what}, as in {min(masks, key=str)}): {likely}"


def _masks(capture: Capture, views: list[View]) -> dict[View, np.ndarray]:
    """(h, w) bool by view, small; views that cannot be read or show nobody are left out."""
    found = {}
    for view in views:
        try:
            mask = capture.read(view)[1]
        except UserError:  # its own fault, told elsewhere
            continue
        small = _small(capture.camera(view))
        person = cv2.resize(mask, (small.width, small.height), interpolation=cv2.INTER_AREA) > 127
        if person.any():
            found[view] = person
    return found


def _small(camera: Camera) -> Camera:
    return camera.scaled(min(1.0, SIDE / max(camera.width, camera.height)))


def _bones(capture: Capture, body: BodyData) -> _Bones:
    motion, count = capture.motion, SMPL_BODY_JOINTS
    rest = body.shaped(motion.betas)[1][:count]
    poses = check_motion_fits(motion.poses, count).astype(np.float64)
    T = joint_transforms(poses, rest, body.parents[:count])
    joints = T[..., :3, 3] + motion.trans[:, None].astype(np.float64)
    return _Bones(joints, np.asarray(body.parents[:count]))


def _overlaps(masks: dict[View, np.ndarray], place: Place, parents: np.ndarray) -> np.ndarray:
    """Intersection over union of drawn body and mask, a number a view."""
    found = []
    for view, mask in masks.items():
        drawn = silhouette(*place(view), parents)
        union = (drawn | mask).sum()
        found.append((drawn & mask).sum() / union if union else 0.0)
    return np.array(found)


def silhouette(joints: np.ndarray, camera: Camera, parents: np.ndarray) -> np.ndarray:
    """(h, w) bool, the longer side 128 pixels at most: bones of joints (J, 3), world, drawn as wide as limbs, with a
    head; what is behind the camera is left out."""
    camera = _small(camera)
    image = np.zeros((camera.height, camera.width), np.uint8)
    with np.errstate(all="ignore"):
        pixels = camera.project(joints)
    reach = 4 * SIDE  # beyond it nothing is seen, and OpenCV counts in 32 bits
    seen = np.isfinite(pixels).all(-1) & (pixels[:, 2] > 1e-3) & (np.abs(pixels[:, :2]) < reach).all(-1)
    for joint, parent in enumerate(parents):
        if parent >= 0 and seen[joint] and seen[parent]:
            width = LIMB * camera.fx * 2 / (pixels[joint, 2] + pixels[parent, 2])
            start, end = (tuple(int(v) for v in np.round(pixels[j, :2])) for j in (parent, joint))
            cv2.line(image, start, end, 1, int(np.clip(round(width), 1, SIDE)))
    if seen[_HEAD]:
        radius = int(np.clip(round(HEAD * camera.fx / pixels[_HEAD, 2]), 1, SIDE))
        cv2.circle(image, tuple(int(v) for v in np.round(pixels[_HEAD, :2])), radius, 1, -1)
    return image.astype(bool)


def _likely(capture: Capture, bones: _Bones, masks: dict[View, np.ndarray]) -> str | None:
    """The other reading under which body and masks meet best, if they do under any."""
    best, cause = MEET, None
    for words, place in [*_readings(capture, bones), _focal(capture, bones, masks)]:
        overlap = float(np.median(_overlaps(masks, place, bones.parents)))
        if overlap > best:
            best, cause = overlap, words
    return cause and f"they do meet (overlap {best:.2f}) {cause}"


def _focal(capture: Capture, bones: _Bones, masks: dict[View, np.ndarray]) -> tuple[str, Place]:
    """The reading by which the body is as large as the masks' person: other focal lengths."""
    drawn = [silhouette(bones.joints[v.frame], capture.camera(v), bones.parents).sum() for v in masks]
    ratio = float(np.median([np.sqrt(mask.sum() / max(n, 1)) for mask, n in zip(masks.values(), drawn, strict=True)]))

    def place(view: View) -> tuple[np.ndarray, Camera]:
        camera = capture.camera(view)
        return bones.joints[view.frame], dataclasses.replace(camera, fx=camera.fx * ratio, fy=camera.fy * ratio)

    return f"with focal lengths {ratio:.2g} times as long: poses and cameras seem to be of different estimates", place


def _readings(capture: Capture, bones: _Bones) -> list[tuple[str, Place]]:
    """What is often mistaken, and where body and camera are if it was: words to end a sentence with."""
    turn = np.eye(4)  # from the data set's world, where mistakes are made, to the capture's
    if capture.placement is not None:
        turn[:3, :3] = capture.placement.turn
    last = len(bones.joints) - 1

    def cameras(change: Callable[[np.ndarray], np.ndarray]) -> Place:
        def place(view: View) -> tuple[np.ndarray, Camera]:
            camera = capture.camera(view)
            T = change(camera.T_camera_world @ turn) @ turn.T
            return bones.joints[view.frame], dataclasses.replace(camera, T_camera_world=T)

        return place

    def shifted(T: np.ndarray, factor: float) -> np.ndarray:
        return np.block([[T[:3, :3], T[:3, 3:] * factor], [np.zeros((1, 3)), np.ones((1, 1))]])

    def turned(x: np.ndarray, R: np.ndarray) -> np.ndarray:
        return x @ R.T

    def bodies(change: Callable[[np.ndarray], np.ndarray]) -> Place:
        return lambda view: (change(bones.joints[view.frame]), capture.camera(view))

    def scaled(factor: float) -> Place:
        trans = capture.motion.trans.astype(np.float64)
        return lambda view: (bones.joints[view.frame] + (factor - 1) * trans[view.frame], capture.camera(view))

    def frames(offset: int) -> Place:
        return lambda view: (bones.joints[np.clip(view.frame + offset, 0, last)], capture.camera(view))

    found = [
        (f"when the poses are taken {abs(k)} frame{'s' if abs(k) > 1 else ''} {'earlier' if k < 0 else 'later'}: poses "
         "and images seem to start at different frames", frames(k)) for k in OFFSETS if abs(k) <= last
    ]  # fmt: skip
    found += [
        ("when the cameras' matrices are inverted: give world to camera, not camera to world", cameras(invert_rigid)),
        ("when the cameras look along -z: give OpenCV's axes (x right, y down, z forward), not OpenGL's",
         cameras(lambda T: OPENGL @ T)),
        ("when the cameras' matrices are inverted and look along -z: give world to camera in OpenCV's axes, not camera "
         "to world in OpenGL's", cameras(lambda T: OPENGL @ invert_rigid(T))),
    ]  # fmt: skip
    for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2)):
        found.append((f"when the body's translations are {unit}: give metres", scaled(factor)))
        near, far = functools.partial(shifted, factor=factor), functools.partial(shifted, factor=1 / factor)
        found.append((f"when the cameras' translations are {unit}: give metres", cameras(near)))
        found.append((f"when the cameras' translations were metres taken for {unit}", cameras(far)))
    found += [
        (f"when the body's world has {axis} up: bring poses and cameras into one world",
         bodies(functools.partial(turned, R=R)))
        for axis, R in Y_UP_FROM.items() if axis != "y"
    ]  # fmt: skip
    return found
