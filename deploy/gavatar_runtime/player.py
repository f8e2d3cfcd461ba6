"""Playing: every frame of a motion through decoding, skinning and splatting into a writer, each stage timed."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from .avatar import Avatar
from .camera import Camera
from .errors import UserError
from .motion import Motion
from .plugins import load_entry_points
from .registry import Registry
from .writers import Writer, to_bytes

WARM_UP = 3  # frames left out of the medians where there are more: first use of buffers and networks
OTHER, WRITE = "other", "write"
AUTO = ("native", "numpy")  # rasterizers that `auto` tries, the first that is there to be used


@dataclasses.dataclass
class Timings:
    """Seconds of each stage, one number a frame: encode, decode, skin, what the rasterizer names (project, sort,
    blend), other (whatever none of them counted) and write."""

    stages: dict[str, list[float]] = dataclasses.field(default_factory=dict)

    def add(self, seconds: dict[str, float]) -> None:
        """Append one frame."""
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
        rows = [v for stage, v in self.stages.items() if stage != WRITE]
        return float(np.median(_warm(np.sum(rows, 0)))) if rows else float("nan")

    @property
    def frames_per_second(self) -> float:
        """Frames a second that could be shown: writing is not part of it."""
        return 1 / self.frame_seconds


def _warm(values: Sequence[float]) -> Sequence[float]:
    return values[WARM_UP:] if len(values) > WARM_UP else values


def play(
    avatar: Avatar,
    motion: Motion,
    cameras: Camera | Sequence[Camera],
    rasterizer,
    writer: Writer,
    *,
    background: Sequence[float] = (1.0, 1.0, 1.0),
    progress: Callable[[int, int], None] | None = None,
) -> Timings:
    """Write a motion's frames and return what each stage of each took.

    motion: fitted to the avatar. cameras: one for all frames, or one a frame. rasterizer: an object with
    `render(gaussians, camera, background) -> Rendering` and, after it, `stage_seconds`; if it has `render_uint8`, which
    returns (H, W, 3) bytes, that is used. With a true `wants_normals`, the avatar gives normals.
    background: sRGB in [0, 1].
    progress: called as `progress(done, total)` after each frame. If anything fails, the writer leaves nothing behind.
    """
    cameras = [cameras] * len(motion) if isinstance(cameras, Camera) else cameras
    if len(cameras) != len(motion):
        raise ValueError(f"{len(cameras)} cameras for {len(motion)} frames")
    background = np.asarray(background, np.float32)
    if getattr(rasterizer, "wants_normals", False):
        avatar.with_normals = True
    timings = Timings()
    wanted = writer.choose(len(motion))
    render = getattr(rasterizer, "render_uint8", None) or (lambda *scene: to_bytes(rasterizer.render(*scene).color))
    try:
        for done, frame in enumerate(wanted, 1):
            start = perf_counter()
            gaussians = avatar.gaussians(motion.poses[frame], motion.trans[frame])
            image = render(gaussians, cameras[frame], background)
            drawn = perf_counter()
            writer.add(image)
            written = perf_counter()
            stages = {**avatar.stage_seconds, **rasterizer.stage_seconds}
            other = max(0.0, drawn - start - sum(stages.values()))
            timings.add({**stages, OTHER: other, WRITE: written - drawn})
            if progress is not None:
                progress(done, len(wanted))
        writer.close()
    finally:
        writer.discard()
    return timings


def build_rasterizer(name: str = "auto", options: Mapping[str, Any] | None = None, *, threads: int | None = None):
    """The player's rasterizer `name`; `auto` is the native one where it is there to be used, else the NumPy one.

    threads: passed on to a rasterizer that has such an option. Raises UserError for an unknown name or option.
    """
    registry = player_rasterizers()
    if name == "auto":
        for candidate in AUTO:
            if candidate in registry:
                with contextlib.suppress(UserError):
                    return build_rasterizer(candidate, options, threads=threads)
        return build_rasterizer(AUTO[-1], options, threads=threads)  # for its error
    if name not in registry:
        load_entry_points()
    fields = {field.name for field in dataclasses.fields(registry[name].config)}
    given = {"threads": threads} if threads is not None and "threads" in fields else {}
    return registry.build(name, {**given, **(options or {})})


def player_rasterizers() -> Registry:
    """The registry of the player's rasterizers, filled by the modules of `gavatar_runtime.rasterizers`."""
    from . import rasterizers

    for module in pkgutil.iter_modules(rasterizers.__path__):
        importlib.import_module(f"{rasterizers.__name__}.{module.name}")
    return rasterizers.PLAYER_RASTERIZERS
