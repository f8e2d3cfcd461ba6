"""Playing: every frame of a motion through decoding, skinning and splatting into a writer, each stage timed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from time import perf_counter

import numpy as np

from ..avatar.played import PlayedAvatar
from ..render.rasterizers import Rasterizer
from ..render.renderer import Renderer
from ..values.camera import Camera
from ..values.motion import Motion
from .writers import Writer

WARM_UP = 3  # frames left out of the medians where there are more: first use of buffers and networks
OTHER, WRITE = "other", "write"


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


def play(
    avatar: PlayedAvatar,
    motion: Motion,
    cameras: Camera | Sequence[Camera],
    rasterizer: Rasterizer,
    writer: Writer,
    *,
    background: Sequence[float] = (1.0, 1.0, 1.0),
    progress: Callable[[int, int], None] | None = None,
    pipelined: bool = True,
) -> Timings:
    """Write a motion's frames and return what each stage of each took.

    motion: fitted to the avatar. cameras: one for all frames, or one a frame. background: sRGB
    in [0, 1].
    pipelined: decode a frame while the one before is drawn, and write in a thread of its own; the same images.
    progress: called as `progress(done, total)` after each frame. If anything fails, the writer leaves nothing behind.
    """
    cameras = [cameras] * len(motion) if isinstance(cameras, Camera) else cameras
    if len(cameras) != len(motion):
        raise ValueError(f"{len(cameras)} cameras for {len(motion)} frames")
    background = np.asarray(background, np.float32)
    renderer = Renderer(avatar, rasterizer)
    avatar.follow(motion)
    timings = Timings()
    wanted = writer.choose(len(motion))
    threads = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
    decoding, writing = threads if pipelined else (_Inline(), _Inline())

    kept: list[np.ndarray] = []  # the image that is being written, while the rasterizer draws the next

    def decode(frame: int):
        gaussians = renderer.gaussians(*motion.at(frame), camera=cameras[frame])
        return gaussians, dict(avatar.stage_seconds)

    def write(image: np.ndarray) -> float:
        start = perf_counter()
        writer.add(image)
        return perf_counter() - start

    try:
        ahead = decoding.submit(decode, wanted[0]) if wanted else None
        start, written = perf_counter(), None
        for done, frame in enumerate(wanted, 1):
            gaussians, stages = ahead.result()
            if done < len(wanted) and pipelined:
                ahead = decoding.submit(decode, wanted[done])
            image = renderer.rasterize_uint8(gaussians, cameras[frame], background)
            stages |= rasterizer.stage_seconds
            drawn = perf_counter()
            before = 0.0 if written is None else written.result()  # at most one frame waits to be written
            if pipelined:
                if not kept or kept[0].shape != image.shape:
                    kept[:] = [np.empty_like(image)]
                np.copyto(kept[0], image)
                image = kept[0]
            written = writing.submit(write, image)
            wall = drawn - start
            timings.add({**stages, OTHER: max(0.0, wall - sum(stages.values())), WRITE: before}, wall)
            avatar.frame_took(wall)
            if progress is not None:
                progress(done, len(wanted))
            start = perf_counter()
            if done < len(wanted) and not pipelined:
                ahead = decoding.submit(decode, wanted[done])
        if written is not None:
            timings.stages[WRITE] = [*timings.stages[WRITE][1:], written.result()]
        writer.close()
    finally:
        for thread in threads:
            thread.shutdown(wait=True, cancel_futures=True)
        writer.discard()
    return timings


class _Inline:
    """An executor that does at once what is asked of it."""

    def submit(self, function, *arguments) -> Future:
        future: Future = Future()
        future.set_result(function(*arguments))
        return future
