"""The frame loop: every frame of a motion is decoded, drawn where images are wanted, and given to an output, each
stage timed."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from time import perf_counter
from typing import Any, Generic

import numpy as np

from ..avatar.played import PlayedAvatar
from ..render.renderer import Renderer
from ..values.camera import Camera
from ..values.gaussians import Gaussians, together
from ..values.motion import Motion
from .outputs.output import Frame, Output

WARM_UP = 3  # frames left out of the medians where there are more: first use of buffers and networks
OTHER, WRITE = "other", "write"
Progress = Callable[[int, int], None]


@dataclasses.dataclass
class Timings:
    """Seconds of each stage, one number a frame: encode, decode, skin, what the rasterizer names (project, sort,
    blend), other (whatever none of them counted) and write."""

    stages: dict[str, list[float]] = dataclasses.field(default_factory=dict)
    walls: list[float] = dataclasses.field(default_factory=list)

    def add(self, seconds: dict[str, float], wall: float | None = None) -> None:
        """Append one frame. wall: seconds from the frame before to this one, where stages ran beside each other."""
        if wall is not None:
            self.walls.append(wall)
        for stage, value in seconds.items():
            self.stages.setdefault(stage, []).append(value)

    def __len__(self) -> int:
        """Frames timed."""
        return max((len(v) for v in self.stages.values()), default=0)

    def medians(self) -> dict[str, float]:
        """Median seconds of each stage, the first frames left out as far as others remain."""
        return {stage: float(np.median(_warm(v))) for stage, v in self.stages.items()}

    @property
    def frame_seconds(self) -> float:
        """Median seconds of a frame without its writing; NaN before the first."""
        if self.walls:
            return float(np.median(_warm(self.walls)))
        rows = [v for stage, v in self.stages.items() if stage != WRITE]
        return float(np.median(_warm(np.sum(rows, 0)))) if rows else float("nan")

    @property
    def frames_per_second(self) -> float:
        """Frames a second that could be shown: writing is not part of it."""
        return 1 / self.frame_seconds


def _warm(values: Sequence[float]) -> Sequence[float]:
    return values[WARM_UP:] if len(values) > WARM_UP else values


def play_images(
    renderer: Renderer,
    motion: Motion,
    cameras: Camera | Sequence[Camera],
    output: Output[np.ndarray],
    *,
    background: Sequence[float] = (1.0, 1.0, 1.0),
    beside: Sequence[tuple[Renderer, Motion]] = (),
    progress: Progress | None = None,
    pipelined: bool = True,
) -> Timings:
    """Draw a motion's frames into an output, and return what each stage of each took.

    motion: fitted to the renderer's avatar. cameras: one for all frames, or one a frame. background: sRGB in [0, 1].
    beside: other avatars in the picture, each by a renderer of its own and a motion of as many frames; the first
    renderer draws all Gaussians together, so that who is nearer hides who is behind.
    pipelined: decode a frame while the one before is drawn, and write in a thread of its own; the same images.
    progress: called as `progress(done, total)` after each frame. If anything fails, the output leaves nothing behind.
    """
    cameras = [cameras] * len(motion) if isinstance(cameras, Camera) else cameras
    if len(cameras) != len(motion):
        raise ValueError(f"{len(cameras)} cameras for {len(motion)} frames")
    _check_lengths(motion, [other for _, other in beside])
    frames = _Images(renderer, motion, cameras, background, beside)
    return _play(frames, output, progress, pipelined)


def play_gaussians(
    avatar: PlayedAvatar,
    motion: Motion,
    output: Output[Gaussians],
    *,
    beside: Sequence[tuple[PlayedAvatar, Motion]] = (),
    progress: Progress | None = None,
    pipelined: bool = True,
) -> Timings:
    """As `play_images`, for an output that takes the Gaussians: nothing is drawn."""
    _check_lengths(motion, [other for _, other in beside])
    return _play(_Gaussians(avatar, motion, beside), output, progress, pipelined)


def _check_lengths(motion: Motion, others: Sequence[Motion]) -> None:
    for other in others:
        if len(other) != len(motion):
            raise ValueError(f"motions of {len(motion)} and {len(other)} frames cannot be played beside each other")


def _summed(stages: Sequence[dict[str, float]]) -> dict[str, float]:
    """Seconds by stage of all avatars."""
    return {name: sum(s.get(name, 0.0) for s in stages) for name in dict.fromkeys(n for s in stages for n in s)}


class _Frames(abc.ABC, Generic[Frame]):
    """How the frames of a motion are made: first `decode`, which may run in another thread, then `finish`."""

    def __init__(self, avatar: PlayedAvatar, motion: Motion, beside: Sequence[tuple[PlayedAvatar, Motion]] = ()):
        self.motion, self.played = motion, [(avatar, motion), *beside]

    @abc.abstractmethod
    def decode(self, frame: int) -> tuple[Gaussians, dict[str, float]]:
        """The Gaussians of a frame, and the seconds of each stage."""

    @abc.abstractmethod
    def finish(self, gaussians: Gaussians, frame: int) -> tuple[Frame, dict[str, float]]:
        """What the output takes, and the seconds of each stage."""

    @abc.abstractmethod
    def kept(self, result: Frame) -> Frame:
        """The result in arrays that stay while the next one is finished."""


class _Images(_Frames[np.ndarray]):
    def __init__(
        self, renderer: Renderer, motion: Motion, cameras: Sequence[Camera], background: Sequence[float],
        beside: Sequence[tuple[Renderer, Motion]] = (),
    ):  # fmt: skip
        super().__init__(renderer.avatar, motion, [(other.avatar, its) for other, its in beside])
        self._drawn = [(renderer, motion), *beside]
        self._renderer, self._cameras, self._background = renderer, cameras, background
        self._kept: np.ndarray | None = None

    def decode(self, frame: int) -> tuple[Gaussians, dict[str, float]]:
        camera = self._cameras[frame]
        parts = [renderer.gaussians(*motion.at(frame), camera=camera) for renderer, motion in self._drawn]
        return together(parts), _summed([avatar.stage_seconds for avatar, _ in self.played])

    def finish(self, gaussians: Gaussians, frame: int) -> tuple[np.ndarray, dict[str, float]]:
        image = self._renderer.rasterize_uint8(gaussians, self._cameras[frame], self._background)
        return image, self._renderer.rasterizer.stage_seconds

    def kept(self, result: np.ndarray) -> np.ndarray:
        if self._kept is None or self._kept.shape != result.shape:
            self._kept = np.empty_like(result)
        np.copyto(self._kept, result)
        return self._kept


class _Gaussians(_Frames[Gaussians]):
    def decode(self, frame: int) -> tuple[Gaussians, dict[str, float]]:
        parts = [avatar.gaussians(*motion.at(frame), copy=False) for avatar, motion in self.played]
        return together(parts), _summed([avatar.stage_seconds for avatar, _ in self.played])

    def finish(self, gaussians: Gaussians, frame: int) -> tuple[Gaussians, dict[str, float]]:
        return gaussians, {}

    def kept(self, result: Gaussians) -> Gaussians:
        """As it is: the third decode from a frame's own fills its arrays again, and begins when it is written."""
        return result


def _play(frames: _Frames[Frame], output: Output[Frame], progress: Progress | None, pipelined: bool) -> Timings:
    for avatar, motion in frames.played:
        avatar.follow(motion)
    timings: Timings = Timings()
    wanted = output.choose(len(frames.motion))
    threads = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
    decoding, writing = threads if pipelined else (_Inline(), _Inline())

    def write(result: Frame) -> float:
        start = perf_counter()
        output.add(result)
        return perf_counter() - start

    try:
        ahead = [decoding.submit(frames.decode, frame) for frame in wanted[:1]]
        written: Future[float] | None = None
        start = perf_counter()
        for done, frame in enumerate(wanted, 1):
            gaussians, decoded = ahead.pop().result()
            if done < len(wanted) and pipelined:
                ahead.append(decoding.submit(frames.decode, wanted[done]))
            result, finished = frames.finish(gaussians, frame)
            stages = {**decoded, **finished}
            drawn = perf_counter()
            before = 0.0 if written is None else written.result()  # at most one frame waits to be written
            written = writing.submit(write, frames.kept(result) if pipelined else result)
            wall = drawn - start
            timings.add({**stages, OTHER: max(0.0, wall - sum(stages.values())), WRITE: before}, wall)
            for avatar, _ in frames.played:
                avatar.frame_took(wall)
            if progress is not None:
                progress(done, len(wanted))
            start = perf_counter()
            if done < len(wanted) and not pipelined:
                ahead.append(decoding.submit(frames.decode, wanted[done]))
        if written is not None:
            timings.stages[WRITE] = [*timings.stages[WRITE][1:], written.result()]
        output.close()
    finally:
        for thread in threads:
            thread.shutdown(wait=True, cancel_futures=True)
        output.discard()
    return timings


class _Inline(Executor):
    """An executor that does at once what is asked of it."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future:
        future: Future = Future()
        future.set_result(function(*arguments, **options))
        return future
