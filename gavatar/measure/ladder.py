"""What each way of playing an avatar costs and gains on this machine: the ladder from full networks to a still look."""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
import torch

from gavatar_runtime import native_library
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import Bundle, read_bundle
from gavatar_runtime.decoding.detail import WORTH, uv_for_size
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.play.framing import frame_motion, size_on_screen
from gavatar_runtime.play.player import WRITE, play
from gavatar_runtime.render.choice import build_rasterizer
from gavatar_runtime.render.rasterizers import Rasterizer
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.tiers import DEFAULT, members_read, player_tiers, stored_tiers
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.motion import Motion

from ..capture.capture import Capture, View
from ..images.image_quality import mean_psnr
from ..training.run import Run

WHITE = (1.0, 1.0, 1.0)
WARM = 5  # frames before the measured ones
ROUNDS = 3  # in which choices take turns to be timed, so that a slow spell of the machine is nobody's alone
QUALITY_FRAMES = 12  # evenly spaced over the motion, on which a choice is compared with the full model
SWITCHES = ({"fast": True}, {"backface": 0.3}, {"depth_cut": 0.3}, {"resolution": 0.5})
FOOTAGE_SPLITS = ("novel_pose", "test", "val")  # the first of these that a capture has is what it is held against


@dataclasses.dataclass(frozen=True)
class Choice:
    """One way to play. uv: level of detail, None for all Gaussians. reuse: decode every so many frames. seen_only:
    decode what the camera can see. fast, backface, depth_cut, resolution: of the native rasterizer (`NativeConfig`)."""

    tier: str
    uv: int | None = None
    reuse: int = 1
    seen_only: bool = False
    fast: bool = False
    backface: float = 0.0
    depth_cut: float = 0.0
    resolution: float = 1.0

    @property
    def label(self) -> str:
        parts = [self.tier]
        if self.uv:
            parts.append(f"uv {self.uv}")
        if self.reuse > 1:
            parts.append(f"reuse {self.reuse}")
        if self.seen_only:
            parts.append("seen only")
        if self.fast:
            parts.append("fast")
        for name in ("backface", "depth_cut", "resolution"):
            if name in self.switches:
                parts.append(f"{name} {self.switches[name]:g}")
        return ", ".join(parts)

    @property
    def switches(self) -> dict:
        """Those of the rasterizer's options that are not off."""
        defaults = {f.name: f.default for f in dataclasses.fields(self)}
        names = ("fast", "backface", "depth_cut", "resolution")
        return {name: getattr(self, name) for name in names if getattr(self, name) != defaults[name]}

    def open(self, bundle: Bundle, threads: int | None = None) -> Avatar:
        return Avatar(bundle, tier=self.tier, uv=self.uv, reuse=self.reuse, seen_only=self.seen_only, threads=threads)

    def rasterizer(self, threads: int | None = None, trained: dict | None = None) -> Rasterizer:
        """The native rasterizer where it is there to be used, else NumPy's, which knows none of its switches. trained:
        those of the bundle's manifest."""
        try:
            return build_rasterizer("native", self.switches, threads=threads, trained=trained)
        except UserError:
            return build_rasterizer("numpy", trained=trained)


@dataclasses.dataclass
class Row:
    """What one choice measured. fps, median_ms, spread_ms (10th to 90th percentile): of whole frames, writing excluded.
    stage_ms: medians by stage; with stages beside each other their sum exceeds a frame. first_frame_s: a new process
    from its start to its first image; memory_mb: its peak resident memory over the whole motion. bundle_mb: members
    that the tier reads. psnr_*: dB over whole frames on white. dominated: another choice is both faster and closer to
    the full model."""

    choice: Choice
    gaussians: int
    width: int
    height: int
    fps: float = float("nan")
    median_ms: float = float("nan")
    spread_ms: tuple[float, float] = (float("nan"), float("nan"))
    stage_ms: dict[str, float] = dataclasses.field(default_factory=dict)
    psnr_vs_full: float | None = None
    worst_psnr_vs_full: float | None = None
    perceptual_vs_full: float | None = None
    psnr_vs_footage: float | None = None
    worst_psnr_vs_footage: float | None = None
    perceptual_vs_footage: float | None = None
    memory_mb: float | None = None
    first_frame_s: float | None = None
    bundle_mb: float | None = None
    frames: int = 0
    dominated: bool = False

    def as_json(self) -> dict:
        values = dataclasses.asdict(self)
        choice = values.pop("choice")
        values = {"tier": choice["tier"], "label": self.choice.label, **choice, **values}
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in values.items()}


class _Nowhere:
    """A writer that keeps nothing: writing is excluded from what is measured."""

    def choose(self, count: int) -> list[int]:
        return list(range(count))

    def add(self, image: np.ndarray) -> None:
        pass

    def close(self) -> None:
        pass

    def discard(self) -> None:
        pass


def default_choices(bundle: Bundle, auto_uv: int | None = None) -> list[Choice]:
    """The ladder of a bundle: every stored tier, and on them the cheaper levels of detail, temporal reuse, decoding
    what is seen and the rasterizer's switches, where they can pay: nothing makes the networks of `full` fast, and
    nothing is reused by `baked`. auto_uv: what `detail.uv_for_size` says of this picture."""
    stored = stored_tiers(bundle)
    side = bundle.surfaces()[0].resolution
    levels = sorted({uv for uv in (64, 128, 256, 384, auto_uv or side) if uv < WORTH * side})
    choices = [Choice(tier) for tier in stored]
    kinds = {tier: player_tiers()[tier].factory for tier in stored}
    networks = [t for t in stored if kinds[t].networks] if bundle.manifest.dynamic else []
    cheap = [t for t in stored if t not in networks] or stored
    choices += [Choice(tier, uv=uv) for tier in cheap for uv in levels]
    if native_library.available()[0]:  # they are the compiled kernel's
        choices += [Choice(tier, **switch) for tier in cheap for switch in SWITCHES]
    choices += [Choice(tier, reuse=k) for tier in networks if tier != DEFAULT for k in (2, 4)]
    choices += [
        Choice(tier, seen_only=True) for tier in networks if Choice(tier, seen_only=True).open(bundle).seen_only
    ]
    finer = [uv for uv in levels if uv >= 256]
    choices += [Choice(t, uv=uv) for t in networks if kinds[t].picks and t != DEFAULT for uv in finer]
    return choices


def measure_speeds(
    rows: Sequence[Row],
    bundle: Bundle,
    motion: Motion,
    camera: Camera,
    *,
    threads: int | None = None,
    budget_s: float = 12.0,
    rounds: int = ROUNDS,
) -> None:
    """Fill in fps and stages over the motion, all rounds of a choice together; slow choices see as many of its first
    frames as `budget_s` allows."""
    found: dict[int, list[tuple[np.ndarray, dict]]] = {i: [] for i in range(len(rows))}
    for _ in range(rounds):
        for i, row in enumerate(rows):
            found[i].append(_timed(row.choice, bundle, motion, camera, threads, budget_s / rounds))
    for i, row in enumerate(rows):
        walls = np.concatenate([walls for walls, _ in found[i]])
        row.median_ms = float(np.median(walls))
        row.spread_ms = tuple(float(v) for v in np.percentile(walls, (10, 90)))
        row.fps, row.frames = 1e3 / row.median_ms, len(walls) * row.choice.reuse
        stages = [stages for _, stages in found[i]]
        row.stage_ms = {k: float(np.median([s[k] for s in stages])) for k in stages[0]}


def _timed(
    choice: Choice, bundle: Bundle, motion: Motion, camera: Camera, threads: int | None, budget_s: float
) -> tuple[np.ndarray, dict[str, float]]:
    """Milliseconds of each frame, warm-up left out, and medians by stage."""
    avatar, rasterizer = choice.open(bundle, threads), choice.rasterizer(threads, bundle.manifest.rasterizer)
    renderer = Renderer(avatar, rasterizer)
    start = perf_counter()
    for i in range(2):
        renderer.rasterize(renderer.gaussians(*motion.at(i % len(motion)), camera=camera), camera, WHITE)
    each = (perf_counter() - start) / 2
    count = min(len(motion), max(WARM + 3, int(budget_s / max(each, 1e-4))))
    part = motion.taken(slice(count))
    timings = play(avatar, part, camera, rasterizer, _Nowhere())
    walls = 1e3 * np.array(timings.walls[WARM:])
    # where decodes are reused, frames with one and without take turns: what counts is the mean of a turn
    turns = max(1, len(walls) // choice.reuse)
    walls = walls[: turns * choice.reuse].reshape(turns, -1).mean(1)
    return walls, {k: 1e3 * v for k, v in timings.medians().items() if k != WRITE}


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """dB of two images in [0, 1], at most 100 so that equal ones can be averaged."""
    mse = float(np.mean(np.square(image.astype(np.float64) - reference)))
    return 100.0 if mse < 1e-10 else -10 * np.log10(mse)


def images(choice: Choice, bundle: Bundle, motion: Motion, frames: Sequence[int], cameras: Sequence[Camera]):
    """Images of a choice at `frames` of a motion, each with its camera. Where decodes are reused, the frames before
    are played too, as they would be."""
    avatar = choice.open(bundle)
    renderer = Renderer(avatar, choice.rasterizer(trained=bundle.manifest.rasterizer))
    result, at = [], 0
    for frame, camera in zip(frames, cameras, strict=True):
        if choice.reuse > 1:
            at = max(at, frame - 2 * choice.reuse)
            for earlier in range(at, frame):
                avatar.gaussians(*motion.at(earlier))
        at = frame + 1
        gaussians = renderer.gaussians(*motion.at(frame), camera=camera)
        result.append(np.clip(renderer.rasterize(gaussians, camera, WHITE).color, 0, 1))
    return result


def compare(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray], perceptual=None):
    """Mean and worst PSNR and mean perceptual distance (None without its network) of pairs of images."""
    values = [psnr(a, b) for a, b in zip(ours, theirs, strict=True)]
    distance = None
    if perceptual is not None:
        pairs = [
            [torch.from_numpy(i).float().permute(2, 0, 1)[None] for i in p] for p in zip(ours, theirs, strict=True)
        ]
        distance = float(np.mean([float(perceptual(a, b)) for a, b in pairs]))
    return mean_psnr(values), min(values), distance


def footage(capture: Capture, limit: int = QUALITY_FRAMES) -> tuple[Motion, list[View], list[np.ndarray], str]:
    """Held-out views of a capture on white, the motion that they are held against (true poses where the capture has
    them) and the name of their split. Raises UserError for a capture that holds nothing out."""
    split = next((s for s in FOOTAGE_SPLITS if capture.splits.get(s)), None)
    if split is None:
        raise UserError(
            f"capture '{capture.name}' holds no frames out ({', '.join(FOOTAGE_SPLITS)}): leave --capture out"
        )
    views = capture.views(split)
    views = [views[i] for i in evenly_spaced(len(views), limit)]
    targets = []
    for view in views:
        color, alpha = capture.load(view)
        targets.append(color + (1 - alpha[..., None]))
    return capture.truth or capture.motion, views, targets, split


def measure_process(row: Row, path: Path, frames: int = 30) -> None:
    """Fill in first-frame time and peak memory from new processes of `gavatar-play`."""
    choice = row.choice
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "gavatar_runtime.cli.play", str(path), "--tier", choice.tier, "--quiet"]
        command += ["--width", str(row.width), "--height", str(row.height), "--reuse", str(choice.reuse)]
        command += ["--uv", str(choice.uv)] if choice.uv else []
        command += ["--seen-only"] if choice.seen_only else []
        for name, value in choice.switches.items():
            command += ["--set", f"rasterizer.{name}={str(value).lower()}"]
        start = perf_counter()
        _run([*command, "--frames", "0", "--out", f"{folder}/first.png"])
        row.first_frame_s = perf_counter() - start
        count = 4 if row.median_ms > 100 else frames
        report = Path(folder) / "report.json"
        _run([*command, "--frames", f"0:{count}", "--out", f"{folder}/frames/", "--json", str(report)])
        row.memory_mb = json.loads(report.read_text())["peak_memory_mb"]


def _run(command: list[str]) -> None:
    """Run a command; UserError with its last line if it fails."""
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode:
        raise UserError(f"{' '.join(command[2:])} failed: {(result.stderr.strip().splitlines() or ['no message'])[-1]}")


def tier_bytes(bundle: Bundle, tier: str) -> int:
    """Size of the members that a tier reads."""
    return sum(len(bundle.read(member)) for member in members_read(bundle, [tier]))


def mark_dominated(rows: list[Row]) -> None:
    """Set `dominated` on each row that another beats or equals in both speed and closeness to the full model."""

    def value(row: Row) -> tuple[float, float]:
        return row.fps, row.psnr_vs_full if row.psnr_vs_full is not None else -np.inf

    for row in rows:
        mine = value(row)
        row.dominated = any(
            value(other)[0] >= mine[0] and value(other)[1] >= mine[1] and value(other) != mine for other in rows
        )


def run_ladder(
    path: Path,
    motion: Motion,
    width: int,
    height: int,
    *,
    capture: Capture | None = None,
    choices: Sequence[Choice] | None = None,
    perceptual=None,
    processes: bool = True,
    threads: int | None = None,
    say=lambda text: None,
) -> list[Row]:
    """Measure every choice. motion: fitted to the avatar. perceptual: a function of two (1, 3, H, W) images or None."""
    bundle = read_bundle(path)
    reference = Choice(DEFAULT)
    avatar = Avatar(bundle, tier=None)
    camera = frame_motion(avatar, motion, width, height)
    if choices is None:
        auto = uv_for_size(avatar.surface, size_on_screen(avatar, motion, [camera] * len(motion)))
        choices = default_choices(bundle, auto)
    frames = evenly_spaced(len(motion), QUALITY_FRAMES).tolist()
    full = images(reference, bundle, motion, frames, [camera] * len(frames))
    held = None
    if capture is not None:
        truth, views, targets, _ = footage(capture)
        held = avatar.fit(truth)[0], views, targets, [capture.cameras[v.camera] for v in views]
    rows = [
        Row(
            choice,
            len(Avatar(bundle, tier=None, uv=choice.uv)),
            width,
            height,
            bundle_mb=tier_bytes(bundle, choice.tier) / 1e6,
        )
        for choice in choices
    ]
    measure_speeds(rows, bundle, motion, camera, threads=threads)
    for row in rows:
        choice = row.choice
        ours = images(choice, bundle, motion, frames, [camera] * len(frames))
        row.psnr_vs_full, row.worst_psnr_vs_full, row.perceptual_vs_full = compare(ours, full, perceptual)
        if held is not None:
            truth, views, targets, cameras = held
            ours = images(choice, bundle, truth, [v.frame for v in views], cameras)
            row.psnr_vs_footage, row.worst_psnr_vs_footage, row.perceptual_vs_footage = compare(
                ours, targets, perceptual
            )
        if processes:
            measure_process(row, path)
        say(f"{choice.label}: {row.fps:.1f} frames per second, {row.psnr_vs_full:.1f} dB against full")
    mark_dominated(rows)
    return rows


def describe_tiers(path: Path, run: Run, size: int = 512, progress: bool = False) -> list[dict]:
    """What the manifest says of each stored tier: its error against the full model on poses of the capture and on
    mixed ones that were not filmed, and its cost on this machine."""
    from ..export.tier_source import TierSource

    bundle = read_bundle(path)
    source = TierSource(run, run.avatar.surface, lambda model: b"", progress)
    real = source.train_poses[evenly_spaced(len(source.train_poses), 8)]
    sets = {"capture": real, "mixed": source.random_poses(8, seed=1)}
    sets = {k: Motion(v, np.zeros((len(v), 3), np.float32), 30.0) for k, v in sets.items()}
    avatar = Avatar(bundle, tier=None)
    cameras = {k: frame_motion(avatar, m, size, size) for k, m in sets.items()}

    def draw(tier: str) -> dict[str, list[np.ndarray]]:
        return {k: images(Choice(tier), bundle, m, range(len(m)), [cameras[k]] * len(m)) for k, m in sets.items()}

    motion = sets["capture"]
    many = motion.taken(np.resize(np.arange(len(motion)), 40))
    rows = [Row(Choice(tier), len(run.avatar.surface), size, size) for tier in stored_tiers(bundle)]
    measure_speeds(rows, bundle, many, cameras["capture"], budget_s=3.0)
    full = draw(DEFAULT)
    described = []
    for row in rows:
        tier = row.choice.tier
        entry: dict = {"name": tier, "members": list(player_tiers()[tier].factory.members)}
        drawn = full if tier == DEFAULT else draw(tier)
        for key in sets:
            mean, worst, _ = compare(drawn[key], full[key])
            entry |= {f"psnr_{key}": round(mean, 2), f"worst_psnr_{key}": round(worst, 2)}
        entry |= {"frame_ms": round(row.median_ms, 2), "size": size, "cores": os.cpu_count(), "machine": machine()}
        described.append(entry)
    return described


def yardstick() -> str:
    """What the machine does at this moment, to compare tables of two days by: NumPy's float32 product of two
    2048 x 2048 matrices (all cores), and copying 64 MB (one core)."""
    a, b = np.ones((2048, 2048), np.float32), np.ones(1 << 24, np.float32)

    def rate(work: float, action) -> float:
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
