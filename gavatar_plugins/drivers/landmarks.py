"""Drives an avatar by the landmark networks that ship with gavatar, live."""

from __future__ import annotations

import importlib.util

import numpy as np

from gavatar.optional import install_command
from gavatar.preparation.landmarks import BONES
from gavatar.registry import BODIES, load_plugins
from gavatar_runtime.components import NoOptions
from gavatar_runtime.live.drivers import DRIVERS, Driver, Seen


def _missing() -> str:
    if importlib.util.find_spec("cv2") is None:
        return f"driving an avatar by a camera needs OpenCV, which is not installed: {install_command('video')}"
    return ""


@DRIVERS.register(
    "landmarks",
    summary="MediaPipe's body landmarks and a causal fit, on the processor",
    needs="OpenCV",
    missing=_missing,
    default=True,
)
class LandmarkDriver(Driver):
    """One person, followed by networks that are loaded when the driver is built."""

    lines = BONES

    def __init__(self, config: NoOptions):
        from gavatar.driving.person_follower import PersonFollower

        if not BODIES.having(shipped=True):
            load_plugins()
        self._person = PersonFollower(BODIES.build(BODIES.having(shipped=True)[0]).data)

    def __call__(self, image: np.ndarray, time: float) -> Seen | None:
        """See `Driver`."""
        return self._person(image, time)

    def reset(self) -> None:
        """See `Driver`."""
        self._person.reset()
