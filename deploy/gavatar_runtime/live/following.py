"""Pictures in, poses of an avatar out, as they come: a thread that looks, and whoever draws asks what is newest."""

from __future__ import annotations

import dataclasses
import threading
from time import perf_counter

import numpy as np

from ..avatar.played_body import PlayedBody
from ..errors import UserError
from ..motions import MOTIONS, read_motion
from ..motions.builtin import relaxed_pose
from ..values.motion import Motion
from .drivers import Driver, Seen
from .smoothing import Places, Rotations, blended
from .sources import LivePictures

HOLD, RELAX, RETURN = 0.5, 1.5, 0.3  # seconds: still after the person is gone, to idle, back when they are there
FOLLOWING, HOLDING, IDLE = "following", "holding", "idle"


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """What an avatar does after one picture.

    number: of the picture, from 1. pose: (J, 3) and trans: (3,) for the avatar's body. state: `following` a person,
    `holding` their last pose, or `idle`. seen: None where nobody is in the picture. picture: (H, W, 3) uint8, blue
    first. taken: `perf_counter` when it came. seconds: that looking at it took. tag: what `give` was told of it.
    """

    number: int
    pose: np.ndarray
    trans: np.ndarray
    state: str
    seen: Seen | None
    picture: np.ndarray
    taken: float
    seconds: float
    tag: int = 0


class Steadied:
    """What is seen in picture after picture as smooth poses of a body; while nobody is there it holds, then idles."""

    def __init__(self, body: PlayedBody):
        self.body = body
        named = MOTIONS.having(waits=True)
        idle = read_motion(named[0]) if named else Motion(relaxed_pose()[None], np.zeros((1, 3)), 30.0)
        self.idle = body.fit(idle)[0]
        self.reset()

    def reset(self) -> None:
        """Begin again: what comes next are other pictures."""
        self._turns, self._places = Rotations(), Places()
        self._held: tuple[np.ndarray, np.ndarray] | None = None
        self._absent: float | None = np.inf  # time since which nobody is there; before the first person: idle
        self._idle = 1.0
        self._time: float | None = None

    def __call__(self, seen: Seen | None, time: float) -> tuple[np.ndarray, np.ndarray, str]:
        """Pose (J, 3), translation (3,) and state at `time` seconds."""
        dt = 0.0 if self._time is None else max(0.0, time - self._time)
        first, self._time = self._held is None, time
        if seen is not None:
            motion = Motion(seen.pose[None], seen.trans[None], 1.0, leg_length=seen.leg_length)
            pose, trans, _ = self.body.fit(motion)[0].at(0)
            if self._absent is not None and not first:  # where they come back, not from where they left
                self._turns.reset()
                self._places.reset()
            self._held = self._turns(pose, time), self._places(trans, time)
            self._absent = None
            self._idle = 0.0 if first else max(0.0, self._idle - dt / RETURN)
        elif self._absent is None:
            self._absent = time
        elif time - self._absent > HOLD:
            self._idle = min(1.0, self._idle + dt / RELAX)
        state = FOLLOWING if seen is not None else HOLDING if self._idle == 0 else IDLE
        rest, place, _ = self.idle.at(int(time * self.idle.fps) % len(self.idle))
        if self._held is None or self._idle == 1:
            held = self._held[1] if self._held is not None else np.zeros(3)
            return rest, place + held * (1, 0, 1), state
        pose, trans = self._held
        if self._idle > 0:
            share = self._idle**2 * (3 - 2 * self._idle)  # without a jerk at either end
            pose = blended(pose, rest, share)
            trans = trans + share * (place + trans * (1, 0, 1) - trans)
        return pose, trans, state


class Following:
    """An avatar driven by pictures: of a `LivePictures`, in a thread of its own, or those that are given by `give`.

    body: the avatar's. driver: finds the person. source: None for pictures that are given. A clip that ends begins
    again; a camera that ends stops. `ended` says so, in a sentence, or is ''.
    """

    def __init__(self, body: PlayedBody, driver: Driver, source: LivePictures | None = None):
        self.driver, self.source = driver, source
        self.lines = driver.lines
        self.name = "your camera" if source is None else source.name
        self.ended = ""
        self.rounds = 1
        self._steadied = Steadied(body)
        self._news = threading.Condition()
        self._shown: Shown | None = None
        self._given: tuple[np.ndarray, float, float, int] | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and let the camera go."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._thread.join(5)

    def give(self, image: np.ndarray, seconds: float = 1.0, tag: int = 0) -> bool:
        """Look at a picture, (H, W, 3) uint8, blue first, next; True once it is being looked at. A newer one takes its
        place while it waits."""
        mine = image, perf_counter(), perf_counter(), tag
        with self._news:
            self._given = mine
            self._news.notify_all()
            self._news.wait_for(lambda: self._given is not mine or self._closed, seconds)
            return self._given is not mine

    def newest(self, after: int = 0, seconds: float = 0.0) -> Shown | None:
        """What the avatar does now; None before the first picture. Waits up to `seconds` for a picture whose number is
        above `after`."""

        def there() -> bool:
            return self._closed or (self._shown is not None and self._shown.number > after)

        with self._news:
            self._news.wait_for(there, seconds)
            return self._shown

    def _follow(self) -> None:
        number = 0
        try:
            while (picture := self._next()) is not None:
                image, time, taken, tag = picture
                start = perf_counter()
                seen = self.driver(image, time)
                pose, trans, state = self._steadied(seen, time)
                number += 1
                shown = Shown(number, pose, trans, state, seen, image, taken, perf_counter() - start, tag)
                with self._news:
                    self._shown = shown
                    self._news.notify_all()
        except UserError as error:
            self.ended = str(error)
        finally:
            if self.source is not None:
                self.source.close()

    def _next(self) -> tuple[np.ndarray, float, float, int] | None:
        """The next picture, its time, when it came, and its tag."""
        if self.source is None:
            with self._news:
                self._news.wait_for(lambda: self._closed or self._given is not None)
                given, self._given = self._given, None
                self._news.notify_all()
                return None if self._closed else given
        while not self._closed:
            read = self.source.read()
            if read is not None:
                return (*read, perf_counter(), 0)
            if not self.source.again():
                self.ended = f"{self.name} gives no more pictures"
                return None
            self.rounds += 1
            self.driver.reset()
            self._steadied.reset()
        return None
