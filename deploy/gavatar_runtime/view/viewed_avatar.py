"""What the viewer draws from: an avatar in its tiers and levels of detail, motions, and a page's wishes checked."""

from __future__ import annotations

import collections
import dataclasses
import math
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..avatar.playing import Avatar
from ..bundle import Bundle
from ..errors import UserError, WrongValue, did_you_mean
from ..motions import MOTIONS, built_in_motions, read_motion
from ..play.framing import body_points, facing
from ..play.selection import wanted_count
from ..render.renderer import Renderer
from ..tiers import stored_tiers
from ..values.camera import Camera
from ..values.motion import Motion
from .drive import LIVE, Drive

MOST = 2048  # pixels of a side that a page may ask for
KEPT = 3  # avatars at a tier and a level of detail that stay open
BODY_POINTS = 4000  # that tell a page where the person is in a motion


@dataclasses.dataclass(frozen=True, eq=False)
class Wish:
    """A frame that a page asks for: motion by name, seconds from its start, camera, background sRGB in [0, 1], tier and
    number of Gaussians, None for all."""

    motion: str
    time: float
    camera: Camera
    background: tuple[float, float, float]
    tier: str
    gaussians: int | None

    @classmethod
    def of(cls, message: Mapping[str, Any]) -> Wish:
        """What a message of the page says. Raises WrongValue for a field that is missing or cannot be."""
        width, height = (_whole(message, name, 1, MOST) for name in ("width", "height"))
        given = message.get("camera")
        if not isinstance(given, Mapping):
            raise WrongValue("`camera` is missing")
        view = _numbers(given, "view", (12, 16))
        fx, fy, cx, cy = (_number(given, name) for name in ("fx", "fy", "cx", "cy"))
        if not (fx > 0 and fy > 0):
            raise WrongValue("`camera` has a focal length that is not positive")
        T = np.eye(4)
        T[:3] = np.reshape(view[:12], (3, 4))
        if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-3 or np.linalg.det(T[:3, :3]) < 0:
            raise WrongValue("`camera` has a view that is no rotation")
        r, g, b = np.clip(_numbers(message, "background", (3,)), 0, 1).tolist()
        count = message.get("gaussians")
        return cls(
            _text(message, "motion"), _number(message, "time"), Camera(width, height, fx, fy, cx, cy, T), (r, g, b),
            _text(message, "tier"), None if count is None else _whole(message, "gaussians", 1, 1 << 31),
        )  # fmt: skip


class ViewedAvatar:
    """An avatar and motions, drawn for one page at a time.

    bundle: of the avatar. motions: names of built-in ones and files. tier: that pages begin with, None for the first
    that the bundle holds. gaussians: at most so many at first, `auto` for as many as the footage's pixels were worth,
    None for all. threads: that decode and draw. Its methods
    may be called from any thread; one draws while others wait.
    """

    def __init__(
        self, bundle: Bundle, motions: Sequence[str | Path | Motion] = (), *, tier: str | None = None,
        gaussians: int | str | None = None, threads: int | None = None,
    ):  # fmt: skip
        self.bundle, self.threads = bundle, threads
        self.body = Avatar(bundle, tier=None)
        self.tiers = stored_tiers(bundle)
        self.tier = self._known(tier or self.tiers[0])
        every = bundle.manifest.gaussians
        wanted = every if gaussians is None else wanted_count(gaussians, self.body.surface, self.body.pixel)
        self.gaussians = min(wanted, every)
        self.drive: Drive | None = None  # what a camera does with it
        self.lock = threading.RLock()
        self._motions: dict[str, Motion] = {}
        self._given: dict[str, str | Path] = {}
        self._open: collections.OrderedDict[tuple[str, int | None], Renderer] = collections.OrderedDict()
        for motion in motions:
            self.add(motion)
        for name in (*MOTIONS.having(waits=True), *built_in_motions()):  # with none given, the person waits at first
            self._given.setdefault(name, name)

    @property
    def motion_names(self) -> list[str]:
        """Of all motions that can be played, those given first."""
        live = [LIVE] if self.drive is not None and self.drive.source is not None else []
        return [*live, *self._given]

    def add(self, motion: str | Path | Motion) -> tuple[str, tuple[str, ...]]:
        """Read a motion and keep it under a name of its own; that name, and what there is to note."""
        read = motion if isinstance(motion, Motion) else read_motion(motion)
        fitted, lacking = self.body.fit(read)
        notes = [*read.notes]
        if lacking:
            notes.append(f"the body has no {', '.join(lacking)}: what '{read.name}' does there is left out")
        with self.lock:
            self._given[read.name] = read.name
            self._motions[read.name] = fitted
        return read.name, tuple(notes)

    def add_file(self, name: str, data: bytes) -> tuple[str, tuple[str, ...]]:
        """A motion that a page sent, by the name its file had there; the file is written nowhere that stays."""
        plain = Path(name.replace("\\", "/")).name
        suffix = Path(plain).suffix.lower()
        if not plain or plain.startswith(".") or len(plain) > 200 or not suffix[1:].isalnum():
            raise WrongValue(f"'{name[:60]}' is no name of a motion file")
        with tempfile.TemporaryDirectory(prefix="gavatar-view-") as folder:
            path = Path(folder, "motion" + suffix)
            path.write_bytes(data)
            try:
                motion = read_motion(path)
            except UserError as error:
                raise type(error)(str(error).replace(str(path), plain)) from None
        notes = tuple(note.replace(str(path), plain) for note in motion.notes)
        return self.add(dataclasses.replace(motion, name=Path(plain).stem, notes=notes))

    def motion(self, name: str) -> Motion:
        """Fitted to the body. Raises WrongValue for a name that is not in `motion_names`."""
        with self.lock:
            if name not in self._given:
                raise WrongValue(f"no motion '{name}': {did_you_mean(name, self._given)}")
            if name not in self._motions:
                self.add(self._given[name])
            return self._motions[name]

    def described(self, name: str) -> dict[str, Any]:
        """What a page wants to know of a motion: name, fps, count of frames, and where the person is in it."""
        live = self.drive is not None and name == LIVE
        motion = self.drive.extent() if self.drive is not None and live else self.motion(name)
        points = body_points(self.body, motion)
        points = points[:: max(1, len(points) // BODY_POINTS)]
        low, high = points.min(0), points.max(0)
        extent = {
            "points": np.round(points, 4).tolist(), "low": low.tolist(), "high": high.tolist(),
            "center": ((low + high) / 2).tolist(), "facing": facing(motion),
        }  # fmt: skip
        return {"name": name, "fps": motion.fps, "count": 1 if live else len(motion), "extent": extent}

    def draw(self, wish: Wish) -> tuple[np.ndarray, dict[str, float], int]:
        """(H, W, 3) uint8, milliseconds of each stage, and how many Gaussians were drawn."""
        return self.draw_pose(wish, *self.motion(wish.motion).at_time(wish.time))

    def draw_pose(
        self, wish: Wish, pose: np.ndarray, trans: np.ndarray, expression: np.ndarray | None = None
    ) -> tuple[np.ndarray, dict[str, float], int]:
        """`draw` in a pose of the body instead of one of a motion."""
        start = perf_counter()
        with self.lock:
            renderer = self._renderer(wish.tier, wish.gaussians)
            gaussians = renderer.gaussians(pose, trans, expression, camera=wish.camera)
            image = renderer.rasterize_uint8(gaussians, wish.camera, wish.background).copy()
            stages = {name: 1000 * seconds for name, seconds in renderer.stage_seconds.items()}
        stages["all"] = 1000 * (perf_counter() - start)
        return image, stages, len(gaussians)

    def _renderer(self, tier: str, gaussians: int | None) -> Renderer:
        every = self.bundle.manifest.gaussians
        count = None if gaussians is None or gaussians >= every else level_of_slider(gaussians, every)
        key = self._known(tier), count
        if key not in self._open:
            avatar = Avatar(self.bundle, tier=tier, gaussians=count, threads=self.threads)
            self._open[key] = Renderer(avatar, threads=self.threads)
            while len(self._open) > KEPT:
                self._open.popitem(last=False)
        self._open.move_to_end(key)
        return self._open[key]

    def _known(self, tier: str) -> str:
        if tier not in self.tiers:
            raise WrongValue(f"`tier={tier}`: the bundle has none so called; {did_you_mean(tier, self.tiers)}")
        return tier


def level_of_slider(gaussians: int, every: int) -> int:
    """A level of detail of at most so many of all Gaussians, in steps of a sixteenth and below that in halves, so that
    dragging a slider does not open a hundred avatars."""
    step = every / 16
    while gaussians < step and step > 1:
        step /= 2
    return max(1, int(gaussians // step * step))


def _text(message: Mapping[str, Any], name: str) -> str:
    value = message.get(name)
    if not isinstance(value, str) or len(value) > 500:
        raise WrongValue(f"`{name}` is no text")
    return value


def _number(message: Mapping[str, Any], name: str) -> float:
    value = message.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise WrongValue(f"`{name}` is no number")
    return float(value)


def _whole(message: Mapping[str, Any], name: str, low: int, high: int) -> int:
    value = _number(message, name)
    if not low <= value <= high:
        raise WrongValue(f"`{name}={value:g}`: give a whole number from {low} to {high}")
    return int(value)


def _numbers(message: Mapping[str, Any], name: str, lengths: Sequence[int]) -> np.ndarray:
    value = message.get(name)
    if not isinstance(value, list) or len(value) not in lengths:
        raise WrongValue(f"`{name}` is no list of {' or '.join(map(str, lengths))} numbers")
    return np.array([_number({name: number}, name) for number in value])
