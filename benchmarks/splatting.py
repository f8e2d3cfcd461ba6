"""How fast the rasterizers are: python benchmarks/splatting.py [--json FILE] [--figure FILE] [--quick]

A body covered with isotropic Gaussians, the person 80 % of the image's height. Every rasterizer of the player draws
(mode `forward`), every one of training draws and differentiates (`forward+backward`, color's gradient to means, scales
and colors). Medians over runs that last --seconds together, at least three; a cell expected to take longer than
--patience is left out. Ratios at the end compare within this run.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import torch  # noqa: E402
from splat_scenes import as_numpy, as_torch, body_camera, body_scene, map_fields  # noqa: E402

from gavatar.registry import RASTERIZERS, load_plugins  # noqa: E402
from gavatar_runtime import native_library as nl  # noqa: E402
from gavatar_runtime.errors import UserError  # noqa: E402
from gavatar_runtime.player import player_rasterizers  # noqa: E402
from gavatar_runtime.skinning import skin  # noqa: E402

COUNTS = (12_500, 50_000, 200_000, 800_000)
SIZES = ((256, 256), (512, 512), (1024, 1024), (1920, 1080))
HEADLINE = (200_000, 512, 512)


def measure(run, seconds: float) -> dict[str, float]:
    """median_ms, p10_ms, p90_ms of run(), after one call to warm up."""
    run()
    times, until = [], time.perf_counter() + seconds
    while len(times) < 3 or (time.perf_counter() < until and len(times) < 200):
        start = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - start))
    p10, median, p90 = np.percentile(times, (10, 50, 90))
    return {"median_ms": float(median), "p10_ms": float(p10), "p90_ms": float(p90)}


def forward_run(name: str, options: dict, count: int, camera):
    rasterizer, scene = player_rasterizers().build(name, options), as_numpy(body_scene(count))
    return rasterizer, lambda: rasterizer.render(scene, camera, (1.0, 1.0, 1.0))


def backward_run(name: str, options: dict, count: int, camera):
    rasterizer = RASTERIZERS.build(name, options)
    scene = map_fields(as_torch(body_scene(count)), lambda x: x.requires_grad_())
    upstream = torch.randn((camera.height, camera.width, 3), generator=torch.Generator().manual_seed(0))
    wanted = (scene.means, scene.scales, scene.colors)
    return rasterizer, lambda: torch.autograd.grad(rasterizer(scene, camera).color, wanted, upstream)


RUNS = {"forward": (player_rasterizers(), forward_run), "forward+backward": (RASTERIZERS, backward_run)}


def rows(arguments) -> list[dict]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    found = []
    for mode, (registry, prepare) in RUNS.items():
        for name in registry.names():
            cost = 0.0  # ms a thousand Gaussians and a thousand pixels of the last cell, whichever is more
            for count in arguments.counts:
                for width, height in arguments.sizes:
                    if cost * max(count, 0.2 * width * height) > 1e3 * arguments.patience:
                        continue
                    threads = [t for t in (1, 2, 4, 8, 16) if t < cores] if name == "native" else []
                    if (count, width, height) != HEADLINE:
                        threads = []
                    for used in [*threads, cores]:
                        options = {"threads": used} if name == "native" else {}
                        camera = body_camera(width, height)
                        try:
                            rasterizer, run = prepare(name, options, count, camera)
                            torch.set_num_threads(cores)
                            row = measure(run, arguments.seconds)
                        except (UserError, ImportError) as error:
                            print(f"{mode} {name}: left out ({error})")
                            cost = float("inf")
                            break
                        row = {"rasterizer": name, "mode": mode, "gaussians": count, "width": width, "height": height,
                               "threads": used} | row  # fmt: skip
                        stages = getattr(rasterizer, "stage_seconds", None)
                        if stages:
                            row["stages_ms"] = {k: 1e3 * v for k, v in stages.items()}
                        found.append(row)
                        print(describe(row), flush=True)
                        cost = row["median_ms"] / max(count, 0.2 * width * height)
    return found


def describe(row: dict) -> str:
    stages = " ".join(f"{k} {v:.2f}" for k, v in row.get("stages_ms", {}).items())
    return (
        f"{row['mode']:17}{row['rasterizer']:8}{row['gaussians']:8} {row['width']:5}x{row['height']:<5}"
        f"{row['threads']:3} threads {row['median_ms']:10.2f} ms  [{row['p10_ms']:.2f}, {row['p90_ms']:.2f}]  {stages}"
    )


def skinning_row(seconds: float) -> dict:
    rng = np.random.default_rng(0)
    points = as_numpy(body_scene(200_000)).means
    index = np.repeat(rng.integers(0, 52, (2000, 4)), 100, 0).astype(np.int32)  # neighbours share their joints
    weight = rng.dirichlet(np.ones(4), len(points)).astype(np.float32)
    A, out = rng.normal(size=(52, 4, 4)).astype(np.float32), np.empty_like(points)
    return {"rasterizer": "skinning", "gaussians": len(points)} | measure(
        lambda: skin(points, index, weight, A, out=out), seconds
    )


def print_ratios(found: list[dict]) -> None:
    """How many times faster native is than each other rasterizer, cell by cell."""
    cells = {(r["mode"], r["gaussians"], r["width"], r["height"], r["threads"], r["rasterizer"]): r for r in found}
    for (*cell, name), row in cells.items():
        native = cells.get((*cell, "native"))
        if native and name not in ("native", "auto"):
            ratio = row["median_ms"] / native["median_ms"]
            print(f"{cell[0]:17}{cell[1]:8} {cell[2]:5}x{cell[3]:<5} native is {ratio:7.0f} times as fast as {name}")


def draw(found: list[dict], path: Path) -> None:
    """Median against the number of Gaussians at each size, one panel a mode."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    styles = {"native": "-", "numpy": ":", "torch": "--"}
    most = max(r["threads"] for r in found)
    for axes, mode in zip(figure.subplots(1, 2, sharey=True), RUNS, strict=True):
        for k, (width, height) in enumerate(SIZES):
            for name, style in styles.items():
                line = [(r["gaussians"], r["median_ms"]) for r in found if r["mode"] == mode and r["threads"] == most
                        and r["rasterizer"] == name and (r["width"], r["height"]) == (width, height)]  # fmt: skip
                if line:
                    label = f"{name}, {width}x{height}"
                    axes.loglog(*zip(*line, strict=True), style, marker="o", markersize=3, color=f"C{k}", label=label)
        axes.set(title=f"{mode}, {most} threads", xlabel="Gaussians", ylabel="median, ms")
        axes.grid(True, which="both", alpha=0.2)
        axes.legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--patience", type=float, default=10.0, help="seconds a single picture may take")
    parser.add_argument("--quick", action="store_true", help="only 200,000 Gaussians at 512x512 and 1024x1024")
    arguments = parser.parse_args()
    arguments.counts = (200_000,) if arguments.quick else COUNTS
    arguments.sizes = ((512, 512), (1024, 1024)) if arguments.quick else SIZES
    load_plugins()
    if nl.available()[0]:
        print(f"native: {nl.instruction_set()}, {nl.threads()} threads")
    found = rows(arguments)
    skinning = skinning_row(arguments.seconds)
    print(f"skinning of 200,000 points: {skinning['median_ms']:.2f} ms [{skinning['p10_ms']:.2f}]")
    print_ratios(found)
    if arguments.json:
        temporary = arguments.json.with_suffix(".tmp")
        temporary.write_text(json.dumps(found, indent=1))
        os.replace(temporary, arguments.json)
    if arguments.figure:
        draw(found, arguments.figure)


if __name__ == "__main__":
    main()
