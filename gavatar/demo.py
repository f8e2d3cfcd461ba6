"""The demonstration: embedded capture -> three trainings' worth of comparison -> bundle -> playback without torch."""

from __future__ import annotations

import dataclasses
import importlib.resources
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gavatar_runtime.bundle import Manifest
from gavatar_runtime.conversions import convert
from gavatar_runtime.errors import UserError
from gavatar_runtime.geometry.spacing import evenly_spaced
from gavatar_runtime.tiers import player_tiers

from .capture.capture import View
from .evaluation.close_ups import close_ups
from .evaluation.result import Evaluation
from .evaluation.scores import Evaluator
from .face import TrainedRun, open_run, train
from .overrides import from_overrides
from .storage import atomic, write_json
from .text_table import format_table
from .training.preview import error_map
from .training.run import Run
from .training.stage import STAGE_FILES

HELD_OUT = "novel_pose"  # a motion that training never saw
MOTIONS = ("wave", "turn")


def demo_capture() -> Path:
    """The folder of the capture that comes with the package."""
    return Path(str(importlib.resources.files("gavatar.data") / "studio_demo"))


@dataclasses.dataclass
class DemoResult:
    """What the demonstration measured and wrote. summary: the values of summary.json."""

    summary: dict
    evaluations: dict[str, Evaluation]
    files: list[Path]


def run_demo(out: Path, overrides: Sequence[str] = (), say: Callable[[str], None] = print) -> DemoResult:
    """Train, evaluate, export and play the embedded capture in the folder `out`; finished parts are not done again.

    overrides: Hydra overrides on top of experiment=demo, for all trainings alike.
    """
    start = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    earlier = _seconds_spent(out)
    settings = _settings(overrides)
    say("1/5  baseline: appearance alone, on the estimated poses as they are")
    train(demo_capture(), out=out / "baseline", **settings | {"motion.enabled": False, "stage2.steps": 0})
    say("2/5  avatar: appearance and motion together (stage 1), then dynamics (stage 2)")
    train(demo_capture(), out=out / "avatar", **settings)
    say("3/5  evaluation on frames and poses that training never saw")
    evaluations = _evaluate(out)
    say("4/5  export to ONNX, verified against PyTorch")
    bundle = out / "studio_demo.gavatar"
    run = TrainedRun(_last(evaluations).run)
    # one look for all poses is enough for the page: bases that follow the pose would take as long as the training
    still = [name for name in player_tiers().having(linear=True) if not player_tiers()[name].kind.moves]
    manifest = run.export(bundle, tiers=still if run.dynamic else ()).manifest
    say(f"     {bundle}: positions within {1000 * manifest.export_check['position_m']:.5f} mm of PyTorch")
    say("5/5  playback, in a process without torch")
    plays = {motion: _play(bundle, motion, out) for motion in MOTIONS}
    picture = out / "summary.png"
    summary_picture(evaluations, plays, picture)
    summary = _summary(evaluations, manifest, plays, earlier + time.perf_counter() - start)
    write_json(out / "summary.json", summary)
    page = out / "avatar.html"
    convert(bundle, page)
    files = [out / f"{motion}.mp4" for motion in MOTIONS] + [picture, bundle, out / "summary.json", page]
    return DemoResult(summary, evaluations, files)


def _settings(overrides: Sequence[str]) -> dict[str, Any]:
    """Of all trainings, the preset among them."""
    settings = {"preset": "demo"}
    for name, value in from_overrides(overrides).items():
        if name in ("capture", "out"):
            raise UserError(f"{name} is the demonstration's own: leave '{name}=...' out, or use gavatar-train")
        settings["preset" if name == "experiment" else name] = value
    return settings


def _seconds_spent(out: Path) -> float:
    """Training time of an earlier, interrupted demo in the same folder: part of what its results took."""
    total = 0.0
    for name in ("baseline", "avatar"):
        if (out / name / "metrics.json").exists():
            total += sum(json.loads((out / name / "metrics.json").read_text(encoding="utf-8"))["seconds"].values())
    return total


def _evaluate(out: Path) -> dict[str, Evaluation]:
    runs = {
        "baseline": open_run(out / "baseline"),
        "+opt": open_run(out / "avatar", stage=1),
    }
    if (out / "avatar" / STAGE_FILES[2]).exists():  # else the training refused its dynamics
        runs["+opt+dyn"] = open_run(out / "avatar", stage=2)
    results = {}
    for name, run in runs.items():
        # the perceptual distance is left to gavatar-eval: its network would take a third of the evaluation's time
        steps = FIT_STEPS if name in ("baseline", list(runs)[-1]) else 0
        results[name] = run.evaluate(fit_steps=steps, perceptual=False, dynamics=False, progress=run.config.progress)
    return results


def _last(evaluations: dict[str, Evaluation]) -> Evaluation:
    """That of the avatar as it is exported: with dynamics, unless the training refused them."""
    return list(evaluations.values())[-1]


FIT_STEPS = 40
CLOSE_UP_PIXELS = 320


def _play(bundle: Path, motion: str, out: Path) -> dict:
    """Play a built-in motion to out/<motion>.mp4 in a fresh process; its --json report."""
    report = out / f"{motion}.json"
    command = [
        sys.executable, "-m", "gavatar_runtime.cli.play", str(bundle), "--motion", motion,
        "--out", str(out / f"{motion}.mp4"), "--size", "512", "--json", str(report), "--quiet",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise UserError(f"playing {bundle} failed: {done.stderr.strip().splitlines()[-1:] or done.returncode}")
    return json.loads(report.read_text(encoding="utf-8"))


def _summary(
    evaluations: dict[str, Evaluation], manifest: Manifest, plays: dict[str, dict], seconds: float
) -> dict[str, Any]:
    last = _last(evaluations)
    before, after = last.estimated_mpjpe_mm, last.row("train", "refined").mpjpe_mm
    assert before is not None  # the shipped capture holds the true poses
    assert after is not None
    wave = plays["wave"]
    return {
        "seconds": round(seconds, 1),
        "psnr_baseline": round(evaluations["baseline"].row(HELD_OUT, "true").psnr, 3),
        "psnr_opt": round(evaluations["+opt"].row(HELD_OUT, "true").psnr, 3),
        "psnr_opt_dyn": round(last.row(HELD_OUT, "true").psnr, 3) if "+opt+dyn" in evaluations else None,
        "psnr_split": f"{HELD_OUT}, the capture's true poses, whole 256x256 frames on white",
        "mpjpe_before_mm": round(before[0], 2),
        "mpjpe_after_mm": round(after, 2),
        "export_error_m": manifest.export_check["position_m"],
        "fps": round(wave["frames_per_second"], 2),
        "gaussians": manifest.gaussians,
        "image_size": [wave["width"], wave["height"]],
        "rasterizer": wave["rasterizer"],
        "splits": {name: [row.as_json() for row in result.rows] for name, result in evaluations.items()},
    }


def screen(result: DemoResult) -> str:
    """One screen of results."""
    header = ["PSNR (dB), poses rendered", *result.evaluations]
    cells = [("train", "refined"), ("test", "true"), ("novel_pose", "true"), ("novel_view", "true"),
             ("test", "fitted"), ("novel_pose", "fitted")]  # fmt: skip
    rows = []
    for split, poses in cells:
        values = []
        for evaluation in result.evaluations.values():
            try:
                values.append(f"{evaluation.row(split, poses).psnr:.2f}")
            except KeyError:
                values.append("-")
        label = "estimated/refined" if poses == "refined" else poses
        rows.append([f"{split}, {label}", *values])
    s = result.summary
    gain = s["psnr_opt"] - s["psnr_baseline"]
    cut = 100 * (1 - s["mpjpe_after_mm"] / s["mpjpe_before_mm"])
    more = "dynamics were refused: the avatar is static"
    if s["psnr_opt_dyn"] is not None:
        more = f"dynamics {s['psnr_opt_dyn'] - s['psnr_opt']:+.2f} dB more"
    lines = [
        "",
        format_table(header, rows),
        "",
        f"held-out poses (true poses given): motion optimisation gains {gain:+.2f} dB, {more}",
        f"joint error on training frames: {s['mpjpe_before_mm']:.1f} -> {s['mpjpe_after_mm']:.1f} mm "
        f"({cut:.0f} % less)",
        f"export: {s['gaussians']} Gaussians, positions within {1000 * s['export_error_m']:.5f} mm of PyTorch",
        f"playback: {s['fps']:.1f} frames per second at {s['image_size'][0]}x{s['image_size'][1]} "
        f"({s['rasterizer']}, no torch)",
        f"total: {s['seconds'] / 60:.1f} minutes",
        "",
        *(f"wrote {path}" for path in result.files),
        f"open {result.files[-1]} in a browser: the avatar plays there, also offline and on a phone",
    ]
    return "\n".join(lines)


def summary_picture(evaluations: dict[str, Evaluation], plays: dict[str, dict], path: Path) -> None:
    """Footage, baseline, +opt, +opt+dyn where it is, and error on held-out frames and other cameras; face, hand, hem
    and back from near by in a pose that was held out; then the playback."""
    run = _last(evaluations).run
    capture = run.capture
    held_out = capture.views(HELD_OUT)
    views: list[View] = [held_out[0], held_out[len(held_out) // 2], held_out[-1], *capture.views("novel_view")[1::4]]
    evaluators = {name: Evaluator(result.run, progress=False) for name, result in evaluations.items()}
    columns = [_column(view, run, evaluators) for view in views]
    footage = np.concatenate(columns, 1)
    strips = [_video_strip(Path(report["output"]), footage.shape[1]) for report in plays.values()]
    picture = np.concatenate([footage, _close_up_row(run, held_out[len(held_out) // 2], footage.shape[1]), *strips])
    with atomic(path) as temporary:
        cv2.imwrite(str(temporary), np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8)[..., ::-1])


def _column(view: View, run: Run, evaluators: dict[str, Evaluator]) -> np.ndarray:
    (color, alpha), truth = run.capture.load(view), run.capture.truth
    assert truth is not None  # as in `_summary`
    target = color + (1 - alpha[..., None])
    renders = {name: evaluator.render(view, truth) for name, evaluator in evaluators.items()}
    cells = {f"footage {view}": target, **renders}
    cells["error of the last"] = error_map(target, list(renders.values())[-1])
    return np.concatenate([_captioned(image, text) for text, image in cells.items()])


def _close_up_row(run: Run, view: View, width: int) -> np.ndarray:
    """`close_ups` in the true pose of a view in one row of the given width."""
    assert run.capture.truth is not None  # as in `_summary`
    pictures = close_ups(run, run.capture.truth, view.frame, CLOSE_UP_PIXELS)
    row = np.concatenate([_captioned(image, f"near by: {title}") for title, image in pictures.items()], 1)
    return cv2.resize(row, (width, round(len(row) * width / row.shape[1])), interpolation=cv2.INTER_AREA)


def _captioned(image: np.ndarray, text: str) -> np.ndarray:
    """(H, W, 3) in [0, 1] with `text` in its upper left corner."""
    pixels = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    shade = 0 if pixels[:16].mean() > 127 else 255
    cv2.putText(pixels, text, (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (shade,) * 3, 1, cv2.LINE_AA)
    return pixels.astype(np.float32) / 255


def _video_strip(video: Path, width: int) -> np.ndarray:
    """Evenly spaced frames of a video in one row of the given width."""
    reader = cv2.VideoCapture(str(video))
    frames = []
    while True:
        more, frame = reader.read()
        if not more:
            break
        frames.append(frame[..., ::-1].astype(np.float32) / 255)
    count = max(1, width // 256)
    chosen = [frames[i] for i in evenly_spaced(len(frames), count)]
    strip = np.concatenate([cv2.resize(f, (256, 256), interpolation=cv2.INTER_AREA) for f in chosen], 1)
    strip = np.pad(strip, ((0, 0), (0, width - strip.shape[1]), (0, 0)), constant_values=1.0)
    return _captioned(strip, f"played: {video.stem}")
