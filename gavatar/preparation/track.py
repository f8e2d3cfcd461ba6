"""Following one person through footage: landmarks and a mask in every frame, and what is wrong with the footage."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator

import cv2
import numpy as np

from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.progress import shown

from .hands.hand_network import HandNetworks
from .hands.track import HandTracker
from .landmarks import Landmarks
from .matting import refine_mask
from .pose_network import Pose, PoseNetworks, TrackedPerson

LOOK_AROUND = 24  # frames spread over the footage in which the largest person is sought
PRESENT = 0.5  # least score of the landmark network, as in the published graph
SIMILAR = 0.5  # a person under half the largest one's size in the footage is a bystander


@dataclasses.dataclass(frozen=True)
class Tracked:
    """landmarks: of the T frames, visibility 0 where the person was not found. people: most seen at once. sharpness,
    (T,): variance of the person's second derivatives, grey levels^2, NaN where not found. cut: (T, 4) whether the mask
    runs along the image's left, top, right and bottom edge."""

    landmarks: Landmarks
    people: int
    sharpness: np.ndarray
    cut: np.ndarray


def largest_person(images: Iterable[np.ndarray], networks: PoseNetworks) -> tuple[float, int]:
    """Side in pixels of the largest region in which a person was found (0: none) and the most people seen at once."""
    side, people = 0.0, 0
    for image in images:
        found = networks.detect(image)
        people = max(people, len(found))
        side = max([side, *(p.region.side for p in found)])
    return side, people


def _next(found: list[TrackedPerson], last: Pose | None, least: float) -> TrackedPerson | None:
    """The person to follow: the largest, or, once someone was followed, the one nearest to where they were lost."""
    found = [p for p in found if p.region.side >= least]
    if not found:
        return None
    if last is None:
        return max(found, key=lambda p: p.region.side)
    lost_at = last.following.centre
    return min(found, key=lambda p: float(np.linalg.norm(p.region.centre - lost_at)))


def poses(
    images: Iterable[np.ndarray], networks: PoseNetworks, least: float
) -> Iterator[tuple[np.ndarray, Pose | None]]:
    """Every image with the followed person's pose, None where they were not found.

    least: smallest region, pixels, that a person to be followed may have.
    """
    last: Pose | None = None
    lost = True
    for image in images:
        pose = None if lost or last is None else networks.landmarks(image, last.following)
        if pose is None or pose.score < PRESENT:
            person = _next(networks.detect(image), last, least)
            pose = None if person is None else networks.landmarks(image, person.region)
            # the detector frames a person roughly: ask again where the landmarks say they are
            if pose is not None and pose.score >= PRESENT:
                pose = networks.landmarks(image, pose.following)
        lost = pose is None or pose.score < PRESENT
        last = last if lost else pose
        yield image, None if lost else pose


def track(
    images: Callable[[], Iterable[np.ndarray]],
    count: int,
    write_mask: Callable[[int, np.ndarray], None],
    networks: PoseNetworks,
    what: str,
    fps: float | None = None,
    progress: bool = True,
    watch: Callable[[np.ndarray, np.ndarray], None] = lambda image, mask: None,
    hand_networks: HandNetworks | None = None,
) -> Tracked:
    """Follow the largest person through `count` images (H, W, 3) uint8 BGR and hand each mask (H, W) to `write_mask`.

    images: gives the images from the start each time it is called (twice). what: the footage's name, for messages.
    watch: is shown every image with its mask. hand_networks: look for the hands too. Raises UserError when nobody is
    found.
    """
    sample = set(evenly_spaced(count, LOOK_AROUND).tolist())
    side, people = largest_person((image for t, image in enumerate(images()) if t in sample), networks)
    if side == 0:
        raise UserError(
            f"no person found in {what} (looked at {len(sample)} of {count} frames): "
            "the whole person should be in the picture, upright, and at least a fifth of its height"
        )
    image_points, world, visibility = np.zeros((count, 33, 2)), np.zeros((count, 33, 3)), np.zeros((count, 33))
    sharpness, cut = np.full(count, np.nan), np.zeros((count, 4), bool)
    size = (0, 0)
    hands = None if hand_networks is None else HandTracker(hand_networks, count)
    found = poses(images(), networks, SIMILAR * side)
    for t, (image, pose) in enumerate(shown(found, f"find person in {what}", "frame", total=count, show=progress)):
        size = image.shape[1], image.shape[0]
        if hands is not None:
            hands.look(t, image, pose)
        mask = np.zeros(image.shape[:2], np.uint8)
        if pose is not None:
            image_points[t], world[t] = pose.image[:, :2], pose.world
            visibility[t] = np.where(_inside(pose.image, size), pose.visibility, 0.3 * pose.visibility)
            mask = refine_mask(image, pose.region.paste(pose.outline.astype(np.float32), *size))
            sharpness[t], cut[t] = _sharpness(image, mask), _cut(mask)
        write_mask(t, mask)
        watch(image, mask)
    if not (visibility > 0).any():
        raise UserError(f"a person was seen in {what}, but their landmarks in no frame: are they too small or hidden?")
    landmarks = Landmarks(image_points, visibility, world, fps, *size, None if hands is None else hands.result())
    return Tracked(landmarks, people, sharpness, cut)


def _inside(points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return np.all((points[:, :2] >= 0) & (points[:, :2] <= size), axis=1)


def _sharpness(image: np.ndarray, mask: np.ndarray) -> float:
    """Variance of the Laplacian inside the mask, at 256 pixels a person so that sizes compare."""
    x, y, w, h = cv2.boundingRect(mask)
    if min(w, h) < 8:
        return np.nan
    scale = min(1.0, 256 / max(w, h))
    new = max(8, round(w * scale)), max(8, round(h * scale))
    grey = cv2.resize(cv2.cvtColor(image[y : y + h, x : x + w], cv2.COLOR_BGR2GRAY), new, interpolation=cv2.INTER_AREA)
    inner = cv2.erode(cv2.resize(mask[y : y + h, x : x + w], new, interpolation=cv2.INTER_NEAREST), np.ones((3, 3)))
    values = cv2.Laplacian(grey, cv2.CV_64F)[inner > 127]
    return float(values.var()) if len(values) > 50 else np.nan


def _cut(mask: np.ndarray) -> np.ndarray:
    """(4,) whether the person leaves the picture at the left, top, right, bottom: more than 2 % of the edge."""
    edges = (mask[:, 0], mask[0], mask[:, -1], mask[-1])
    return np.array([(edge > 127).mean() > 0.02 for edge in edges])
