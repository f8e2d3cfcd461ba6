"""The viewer's avatar driven by a camera: a clip's or this machine's, or one that a page has."""

from __future__ import annotations

import threading
import weakref
from time import perf_counter, time
from typing import Any

import numpy as np

from ..avatar.playing import Avatar
from ..errors import WrongValue
from ..live.camera_pictures import decoded
from ..live.drivers import Driver, build_driver, why_not
from ..live.following import Following, Shown, Steadied
from ..live.sources import LivePictures
from ..motions.builtin import relaxed_pose
from ..values.motion import Motion
from ..values.skeletons import SMPLH
from .frame_encoding import encoded

LIVE = "(live)"  # what a page plays then, in the list of motions
WAIT = 0.25  # seconds that a frame waits for the next picture
INSET = 320  # pixels of the longer side of the picture beside the avatar
OWNED = 2.0  # seconds after its last picture for which a page's camera keeps the avatar


class Drive:
    """body: the avatar whose joints are driven. source: what drives it; None: whichever page gives its camera.

    driver: finds the person, None for the one that is installed, built when first needed. Raises UserError with a
    source and no driver (`drivers.why_not`).
    """

    def __init__(self, body: Avatar, source: LivePictures | None = None, driver: Driver | None = None):
        self.body, self.source = body, source
        self._driver = driver
        self._lock = threading.Lock()
        self._sent: weakref.WeakKeyDictionary[Any, int] = weakref.WeakKeyDictionary()
        self._owner: tuple[Any, float] = (None, -np.inf)
        self._following: Following | None = None
        self.rest = Steadied(body.body).idle.at(0)[:2]
        if source is not None:
            self._started()

    @property
    def following(self) -> Following | None:
        """What follows a person; None until a page gives its camera."""
        return self._following

    def told(self) -> dict[str, Any]:
        """What a page is told of it: what drives the avatar, and whether its own camera may."""
        camera = self.source is None and (self._driver is not None or not why_not())
        return {"motion": LIVE, "source": None if self.source is None else self.source.name, "camera": camera}

    def extent(self) -> Motion:
        """Poses of about the room that a person in front of a camera takes: at ease, arms out, arms up."""
        poses = np.stack([relaxed_pose(), np.zeros((len(SMPLH), 3)), np.zeros((len(SMPLH), 3))])
        for side, sign in (("left", 1), ("right", -1)):
            poses[2, SMPLH.index(f"{side}_shoulder"), 2] = sign * 1.1
        return self.body.fit(Motion(poses, np.zeros((3, 3)), 30.0, name=LIVE))[0]

    def take(self, page: Any, data: bytes, tag: int = 0) -> None:
        """A picture of a page's camera, JPEG, which `beside` tells by `tag`. Returns once it is looked at.

        Raises UserError for one that is none, and while another page's camera, or a source, drives the avatar.
        """
        if self.source is not None:
            raise WrongValue(f"{self.source.name} drives this avatar: start gavatar-view without --drive")
        with self._lock:
            owner, last = self._owner
            if owner not in (None, page) and perf_counter() - last < OWNED:
                raise WrongValue("the camera of another page drives this avatar")
            self._owner = page, perf_counter()
        image = decoded(data)
        self._started().give(image, tag=tag)

    def next(self, page: Any) -> Shown | None:
        """What to draw for a page: waits a little for what it was not sent yet. None before the first picture."""
        following = self._following
        if following is None:
            return None
        shown = following.newest(self._sent.get(page, 0), WAIT)
        if shown is not None:
            self._sent[page] = shown.number
        return shown

    def beside(self, shown: Shown | None) -> tuple[dict[str, Any], bytes | memoryview]:
        """What a page shows beside the avatar: a header, with `bytes` of the picture that follows, and the picture."""
        following = self._following
        if shown is None or following is None:
            return {"state": "waiting", "bytes": 0, "source": "", "points": [], "lines": []}, b""
        height, width = shown.picture.shape[:2]
        seen = shown.seen
        picture: bytes | memoryview = b""
        if self.source is not None:  # a page has its own pictures
            picture = _small(shown.picture)
        points = [] if seen is None else np.c_[seen.points / (width, height), seen.visibility].round(4).tolist()
        head = {
            "state": following.ended or shown.state, "number": shown.number, "tag": shown.tag, "source": following.name,
            "round": following.rounds, "points": points, "lines": following.lines, "width": width, "height": height,
            "seconds": round(shown.seconds, 4), "taken": time() - (perf_counter() - shown.taken),
            "bytes": len(picture),
        }  # fmt: skip
        return head, picture

    def close(self) -> None:
        """Let the camera go."""
        if self._following is not None:
            self._following.close()

    def _started(self) -> Following:
        with self._lock:
            if self._following is None:
                driver = self._driver or build_driver()
                self._following = Following(self.body.body, driver, self.source)
            return self._following


def _small(picture: np.ndarray) -> bytes | memoryview:
    """A picture, blue first, as a small JPEG; nothing without the native kernel."""
    import cv2

    factor = INSET / max(picture.shape[:2])
    if factor < 1:
        size = [max(1, round(side * factor)) for side in picture.shape[1::-1]]
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    kind, data = encoded(picture[:, :, ::-1], 75)
    return data if kind == "jpeg" else b""
