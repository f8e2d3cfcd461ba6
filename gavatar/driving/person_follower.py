"""The landmark networks of preparation and the causal fit as one: pictures in, poses out."""

from __future__ import annotations

import numpy as np

from gavatar_runtime.geometry.rotations import axis_angle_from_matrix
from gavatar_runtime.live.drivers import Seen
from gavatar_runtime.values.body import BodyData

from ..preparation.initial import DEFAULT_FOV
from ..preparation.landmarks import INDEX
from ..preparation.pose_network import PoseNetworks, Region
from ..preparation.track import PRESENT
from .causal_fit import CausalFit, Fitted
from .live_skeleton import LiveSkeleton

LOOK = 0.25  # seconds between two looks for a person while there is nobody
_SOLES = [INDEX[f"{side}_{part}"] for side in ("left", "right") for part in ("heel", "foot_index")]
_LEG = ("left_hip", "left_knee", "left_ankle")


class PersonFollower:
    """Follows the largest person of a camera that stands still and level.

    body: whose landmarks are fitted. networks: as preparation has them; they are not asked about the mirror image,
    which would halve the rate. fov: of the camera, degrees over the longer side of its pictures.
    """

    def __init__(self, body: BodyData, networks: PoseNetworks | None = None, fov: float = DEFAULT_FOV):
        self.networks = networks or PoseNetworks()
        self.fit = CausalFit(LiveSkeleton.of(body), fov)
        self.reset()

    def reset(self) -> None:
        """Forget the person and where they stood."""
        self.fit.reset()
        self._standing = Standing()
        self._region: Region | None = None
        self._looked = -np.inf
        self._size: tuple[int, int] | None = None

    def __call__(self, image: np.ndarray, time: float) -> Seen | None:
        """See `gavatar_runtime.live.drivers.Driver`."""
        size = image.shape[1], image.shape[0]
        if size != self._size:  # another camera
            self.reset()
            self._size = size
        region = self._region or self._found(image, time)
        if region is None:
            return None
        pose = self.networks.landmarks(image, region, mirrored=False)
        numbers = np.concatenate([pose.image, pose.world], -1)
        if not (pose.score >= PRESENT and np.isfinite(numbers).all()):
            self._region = None
            return None
        self._region = pose.following
        inside = ((pose.image[:, :2] >= 0) & (pose.image[:, :2] <= size)).all(1)
        visibility = np.where(inside, pose.visibility, 0.3 * pose.visibility)
        fitted = self.fit(pose.image[:, :2], visibility, pose.world, size, time)
        skeleton = self.fit.skeleton
        hip, knee, ankle = (skeleton.joints[skeleton.names.index(name)] for name in _LEG)
        return Seen(
            axis_angle_from_matrix(fitted.rotations), self._standing(fitted, skeleton, time, self.fit.calibrated),
            float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle)), pose.image[:, :2], visibility,
        )  # fmt: skip

    def _found(self, image: np.ndarray, time: float) -> Region | None:
        """Where the largest person is. The detector frames them roughly: the landmarks are asked where exactly."""
        if 0 <= time - self._looked < LOOK:
            return None
        self._looked = time
        people = self.networks.detect(image)
        if not people:
            return None
        person = max(people, key=lambda p: p.region.side)
        return self.networks.landmarks(image, person.region, mirrored=False).following


class Standing:
    """Where a person stands beside where they did when the bones' lengths were known, the floor under the lower foot.

    The floor is the lowest that a sole came to; it is allowed to rise slowly, since a level camera is a guess.
    """

    RISE = 0.25  # metres a second

    def __init__(self) -> None:
        self._start: np.ndarray | None = None
        self._floor, self._time = np.inf, 0.0

    def __call__(self, fitted: Fitted, skeleton: LiveSkeleton, time: float, calibrated: bool) -> np.ndarray:
        """(3,) metres. While the bones' lengths are not `calibrated` the distance is not known: they stay in place."""
        if self._start is None or not calibrated:
            self._start = fitted.trans
        lowest = float(fitted.points[_SOLES, 1].min())
        self._floor = min(lowest, self._floor + self.RISE * min(max(0.0, time - self._time), 1.0))
        self._time = time
        trans = fitted.trans - self._start
        trans[1] = fitted.trans[1] - self._floor + float(skeleton.points[_SOLES, 1].min())
        return trans
