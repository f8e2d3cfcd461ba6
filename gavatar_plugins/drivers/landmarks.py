"""Drives an avatar by the landmark networks that ship with gavatar, live."""

from __future__ import annotations

import dataclasses
import importlib.util

import numpy as np

from gavatar.optional import install_command
from gavatar.preparation.fit_settings import check_numbers
from gavatar.preparation.initial import DEFAULT_FOV
from gavatar.preparation.landmarks import BONES
from gavatar.registry import BODIES, load_room
from gavatar_runtime.live.drivers import DRIVERS, Driver, Seen


def _missing() -> str:
    if importlib.util.find_spec("cv2") is None:
        return f"driving an avatar by a camera needs OpenCV, which is not installed: {install_command('video')}"
    return ""


@dataclasses.dataclass
class LandmarkOptions:
    """fov: field of view of the camera in degrees, over the longer side of its pictures. A guess that is too small
    places the person too far away, and steps towards the camera become too long."""

    fov: float = DEFAULT_FOV


@DRIVERS.register(
    "landmarks",
    config=LandmarkOptions,
    summary="MediaPipe's body landmarks and a causal fit, on the processor",
    needs="OpenCV",
    missing=_missing,
    default=True,
)
class LandmarkDriver(Driver):
    """One person, followed by networks that are loaded when the driver is built."""

    lines = BONES

    def __init__(self, config: LandmarkOptions):
        from gavatar.driving.person_follower import PersonFollower

        check_numbers({"fov": config.fov})
        if not BODIES.having(shipped=True):
            load_room("bodies")  # no more: a window on an avatar has no use for what all plugins import
        self._person = PersonFollower(BODIES.build(BODIES.having(shipped=True)[0]).data, fov=config.fov)

    def __call__(self, image: np.ndarray, time: float) -> Seen | None:
        """See `Driver`."""
        return self._person(image, time)

    def reset(self) -> None:
        """See `Driver`."""
        self._person.reset()
