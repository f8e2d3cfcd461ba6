"""What a way of playing costs on this machine: time by stage, memory, and the wait for the first frame."""

from __future__ import annotations

import dataclasses
import json
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter

import numpy as np

from gavatar_runtime.bundle import Bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.play.outputs.nowhere import Nowhere
from gavatar_runtime.play.player import WRITE, play_images
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

from .choices import Choice

WARM = 5  # frames before the measured ones
ROUNDS = 3  # in which choices take turns to be timed, so that a slow spell of the machine is nobody's alone
SLOW_MS = 100  # from here on a new process plays fewer frames
FRAMES, FRAMES_WHEN_SLOW = 30, 4


@dataclasses.dataclass(frozen=True)
class Speed:
    """Of whole frames, writing excluded. median_ms. spread_ms: 10th to 90th percentile. stage_ms: medians by stage;
    with stages beside each other their sum exceeds a frame. frames: how many were timed."""

    median_ms: float
    spread_ms: tuple[float, float]
    stage_ms: dict[str, float]
    frames: int

    @property
    def fps(self) -> float:
        """Frames a second."""
        return 1e3 / self.median_ms


@dataclasses.dataclass(frozen=True)
class Footprint:
    """Of a new process of `gavatar-play`. first_frame_s: from its start to its first image. memory_mb: its peak
    resident memory over a motion."""

    first_frame_s: float
    memory_mb: float | None


def measure_speeds(
    choices: Sequence[Choice],
    bundle: Bundle,
    motion: Motion,
    camera: Camera,
    *,
    threads: int | None = None,
    budget_s: float = 12.0,
    rounds: int = ROUNDS,
) -> list[Speed]:
    """The speed of each choice over the motion, all its rounds together; slow choices see as many of its first frames
    as `budget_s` allows."""
    found: list[list[tuple[np.ndarray, dict[str, float]]]] = [[] for _ in choices]
    for _ in range(rounds):
        for choice, rows in zip(choices, found, strict=True):
            rows.append(_timed(choice, bundle, motion, camera, threads, budget_s / rounds))
    speeds = []
    for choice, rows in zip(choices, found, strict=True):
        walls = np.concatenate([walls for walls, _ in rows])
        low, high = (float(v) for v in np.percentile(walls, (10, 90)))
        stages = {name: float(np.median([s[name] for _, s in rows])) for name in rows[0][1]}
        speeds.append(Speed(float(np.median(walls)), (low, high), stages, len(walls) * choice.reuse))
    return speeds


def _timed(
    choice: Choice, bundle: Bundle, motion: Motion, camera: Camera, threads: int | None, budget_s: float
) -> tuple[np.ndarray, dict[str, float]]:
    """Milliseconds of each frame, warm-up left out, and medians by stage."""
    renderer = choice.renderer(bundle, threads)
    start = perf_counter()
    for i in range(2):
        renderer.rasterize(renderer.gaussians(*motion.at(i % len(motion)), camera=camera), camera)
    each = (perf_counter() - start) / 2
    count = min(len(motion), max(WARM + 3, int(budget_s / max(each, 1e-4))))
    timings = play_images(renderer, motion.taken(slice(count)), camera, Nowhere())
    walls = 1e3 * np.array(timings.walls[WARM:])
    # where decodes are reused, frames with one and without take turns: what counts is the mean of a turn
    turns = max(1, len(walls) // choice.reuse)
    walls = walls[: turns * choice.reuse].reshape(turns, -1).mean(1)
    return walls, {k: 1e3 * v for k, v in timings.medians().items() if k != WRITE}


def measure_process(choice: Choice, path: Path, width: int, height: int, speed: Speed) -> Footprint:
    """What new processes of `gavatar-play` take for one frame and for some."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "gavatar_runtime.cli.play", str(path), "--tier", choice.tier, "--quiet"]
        command += ["--width", str(width), "--height", str(height), "--reuse", str(choice.reuse)]
        command += ["--gaussians", str(choice.gaussians)] if choice.gaussians else []
        command += ["--seen-only"] if choice.seen_only else []
        for name, value in choice.switches.items():
            command += ["--set", f"rasterizer.{name}={str(value).lower()}"]
        start = perf_counter()
        _run([*command, "--frames", "0", "--out", f"{folder}/first.png"])
        first_frame_s = perf_counter() - start
        count = FRAMES_WHEN_SLOW if speed.median_ms > SLOW_MS else FRAMES
        report = Path(folder) / "report.json"
        _run([*command, "--frames", f"0:{count}", "--out", f"{folder}/frames/", "--json", str(report)])
        return Footprint(first_frame_s, json.loads(report.read_text())["peak_memory_mb"])


def _run(command: list[str]) -> None:
    """Run a command; UserError with its last line if it fails."""
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode:
        raise UserError(f"{' '.join(command[2:])} failed: {(result.stderr.strip().splitlines() or ['no message'])[-1]}")


def yardstick() -> str:
    """What the machine does at this moment, to compare tables of two days by: NumPy's float32 product of two
    2048 x 2048 matrices (all cores), and copying 64 MB (one core)."""
    a, b = np.ones((2048, 2048), np.float32), np.ones(1 << 24, np.float32)

    def rate(work: float, action: Callable[[], np.ndarray]) -> float:
        seconds = []
        for _ in range(9):
            start = perf_counter()
            action()
            seconds.append(perf_counter() - start)
        return work / float(np.median(seconds[1:])) / 1e9

    return f"{rate(2 * 2048**3, lambda: a @ a):.0f} GFLOP/s, {rate(2 * b.nbytes, lambda: b.copy()):.0f} GB/s"


def machine() -> str:
    """The processor's name, as far as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
