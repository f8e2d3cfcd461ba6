"""How fast the rasterizers are: python benchmarks/splatting.py [--json FILE] [--figure FILE] [--quick]

A body covered with isotropic Gaussians, the person 80 % of the image's height. Every rasterizer draws (mode `forward`)
and, if it can, draws and differentiates (`forward+backward`, color's gradient to means, scales and colors). `native` at
200,000 Gaussians and 512x512 also by threads and instruction sets, with each of its switches, and its error against
float64. Medians over runs that last --seconds together, at least three, or two of those above a second; a cell expected
to take longer than --patience is left out. Ratios at the end compare within this run.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch, as `import gavatar` does: idle threads sleep

import reference_splat  # noqa: E402
import torch  # noqa: E402
from splat_scenes import as_numpy, as_torch, body_camera, body_scene, map_fields  # noqa: E402

from gavatar.registry import RASTERIZERS, load_plugins  # noqa: E402
from gavatar_runtime import native_library as nl  # noqa: E402
from gavatar_runtime.cpus import usable_cpus  # noqa: E402
from gavatar_runtime.errors import UserError  # noqa: E402
from gavatar_runtime.formats.files import write_json  # noqa: E402
from gavatar_runtime.geometry.skinning import skin  # noqa: E402
from gavatar_runtime.render.choice import player_rasterizers  # noqa: E402

COUNTS = (12_500, 50_000, 200_000, 800_000)
SIZES = ((256, 256), (512, 512), (1024, 1024), (1920, 1080))
HEADLINE = (200_000, 512, 512)
SWITCHES = (
    {"fast": True}, {"backface": 0.3}, {"backface": 0.1}, {"depth_cut": 0.3}, {"depth_cut": 0.2}, {"resolution": 0.75},
    {"resolution": 0.5}, {"antialiased": True},
)  # fmt: skip
CORES = usable_cpus()


def measure(run, seconds: float) -> dict[str, float]:
    """median_ms, p10_ms, p90_ms of run(), after one call to warm up."""
    start = time.perf_counter()
    run()
    least = 2 if time.perf_counter() - start > 1 else 3
    times, until = [], time.perf_counter() + seconds
    while len(times) < least or (time.perf_counter() < until and len(times) < 200):
        start = time.perf_counter()
        run()
        times.append(1e3 * (time.perf_counter() - start))
    p10, median, p90 = np.percentile(times, (10, 50, 90))
    return {"median_ms": float(median), "p10_ms": float(p10), "p90_ms": float(p90)}


def forward_run(name: str, options: dict, count: int, camera):
    """The rasterizer, and a call that draws: the player's where it has one of that name."""
    if name in player_rasterizers():
        rasterizer, scene = player_rasterizers().build(name, options), as_numpy(body_scene(count))
        return rasterizer, lambda: rasterizer.render(scene, camera, (1.0, 1.0, 1.0))
    rasterizer, scene = RASTERIZERS.build(name, options), as_torch(body_scene(count))
    return rasterizer, lambda: rasterizer(scene, camera)


def backward_run(name: str, options: dict, count: int, camera):
    rasterizer = RASTERIZERS.build(name, options)
    scene = map_fields(as_torch(body_scene(count)), lambda x: x.requires_grad_())
    upstream = torch.randn((camera.height, camera.width, 3), generator=torch.Generator().manual_seed(0))
    wanted = (scene.means, scene.scales, scene.colors)
    return rasterizer, lambda: torch.autograd.grad(rasterizer(scene, camera).color, wanted, upstream)


RUNS = {"forward": forward_run, "forward+backward": backward_run}


def cell(mode: str, name: str, at: tuple[int, int, int], seconds: float, threads: int = CORES, **options) -> dict:
    """One row of the results. Raises UserError or ImportError where the rasterizer cannot do it."""
    count, width, height = at
    given = {"threads": threads, **options} if name == "native" else options
    rasterizer, run = RUNS[mode](name, given, count, body_camera(width, height))
    torch.set_num_threads(threads)
    row = {"rasterizer": name, "mode": mode, "gaussians": count, "width": width, "height": height, "threads": threads}
    row |= measure(run, seconds)
    stages = getattr(rasterizer, "stage_seconds", None)
    if stages:
        row["stages_ms"] = {k: 1e3 * v for k, v in stages.items()}
    return row


def rows(arguments) -> list[dict]:
    """Every rasterizer in every mode, count and size."""
    found = []
    for mode in RUNS:
        for name in sorted({*RASTERIZERS.names(), *(player_rasterizers().names() if mode == "forward" else ())}):
            cost = 0.0  # ms a Gaussian, or a fifth of a pixel, of the last cell, whichever are more
            for at in itertools.product(arguments.counts, arguments.sizes):
                at = (at[0], *at[1])
                work = max(at[0], 0.2 * at[1] * at[2])
                if cost * work > 1e3 * arguments.patience:
                    continue
                try:
                    row = cell(mode, name, at, arguments.seconds)
                except (UserError, ImportError) as error:
                    print(f"{mode} {name}: left out ({error})")
                    break
                found.append(row)
                print(describe(row), flush=True)
                cost = row["median_ms"] / work
    return found


def reference_row() -> dict:
    """The plain float64 reference that the tests hold every rasterizer against, drawn once at the headline."""
    scene, camera = as_numpy(body_scene(HEADLINE[0])), body_camera(*HEADLINE[1:])
    start = time.perf_counter()
    reference_splat.render(scene, camera)
    once = 1e3 * (time.perf_counter() - start)
    at = dict(zip(("gaussians", "width", "height"), HEADLINE, strict=True))
    return {"rasterizer": "reference", "mode": "forward", **at, "threads": 1} | dict.fromkeys(
        ("median_ms", "p10_ms", "p90_ms"), once
    )


def psnr(a: np.ndarray, b: np.ndarray) -> float | None:
    """dB, None where nothing differs."""
    error = float(np.mean((a.astype(np.float64) - b) ** 2))
    return -10 * float(np.log10(error)) if error else None


def native_rows(seconds: float) -> list[dict]:
    """`native` by threads and by instruction set, and with each of its switches, with its PSNR to the exact picture."""
    found = []
    for mode in RUNS:
        for threads in [t for t in (1, 2, 4, 8, 16) if t < CORES]:
            found.append(cell(mode, "native", HEADLINE, seconds, threads))
            print(describe(found[-1]), flush=True)
    for isa in nl.instruction_sets():
        nl.use_instruction_set(isa)
        found += [cell(mode, "native", HEADLINE, seconds) | {"instruction_set": isa} for mode in RUNS]
        print(f"{isa}: {found[-2]['median_ms']:.2f} ms, {found[-1]['median_ms']:.2f} ms with backward", flush=True)
    nl.use_instruction_set(None)
    for size in ((512, 512), (1024, 1024)):
        at, scene, camera = (HEADLINE[0], *size), as_numpy(body_scene(HEADLINE[0])), body_camera(*size)
        plain = cell("forward", "native", at, seconds)
        exact = player_rasterizers().build("native").render(scene, camera).color
        for options in SWITCHES:
            picture = player_rasterizers().build("native", options).render(scene, camera).color
            error = psnr(picture, exact)
            row = cell("forward", "native", at, seconds, **options) | {"switches": options, "psnr_db": error}
            gain = plain["median_ms"] / row["median_ms"]
            print(
                f"{at[1]}x{at[2]} {options}: {row['median_ms']:.2f} ms, gain {gain:.2f}, {error or np.inf:.1f} dB",
                flush=True,
            )
            found.append(row | {"gain": gain})
    return found


def accuracy() -> dict[str, float]:
    """`native` against the torch rasterizer in float64 at the headline: the picture and the gradients."""
    camera, upstream = body_camera(*HEADLINE[1:]), None
    results = []
    for name, dtype in (("native", torch.float32), ("torch", torch.float64)):
        scene = map_fields(as_torch(as_numpy(body_scene(HEADLINE[0])), dtype), lambda x: x.requires_grad_())
        color = RASTERIZERS.build(name)(scene, camera).color
        if upstream is None:
            upstream = torch.randn(color.shape, generator=torch.Generator().manual_seed(0))
        gradients = torch.autograd.grad(color, (scene.means, scene.scales, scene.colors), upstream.to(dtype))
        results.append((color.detach().double(), [g.double() for g in gradients]))
    (mine, my_gradients), (exact, exact_gradients) = results
    off = (mine - exact).abs().amax(-1)
    found = {
        "psnr_db": float(-10 * torch.log10((mine - exact).square().mean())),
        "max_error_255": float(255 * off.max()),
        "flipped_share": float((off > 2 / 255).double().mean()),
    }
    for name, a, b in zip(("means", "scales", "colors"), my_gradients, exact_gradients, strict=True):
        found[f"gradient_{name}_relative_l2"] = float((a - b).norm() / b.norm())
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
    row = {
        "rasterizer": "skinning",
        "mode": "forward",
        "gaussians": len(points),
        "width": 0,
        "height": 0,
        "threads": CORES,
    }
    return row | measure(lambda: skin(points, index, weight, A, out=out), seconds)


def print_ratios(found: list[dict]) -> None:
    """How many times faster native is than each other rasterizer, cell by cell."""
    cells = {(r["mode"], r["gaussians"], r["width"], r["height"], r["rasterizer"]): r["median_ms"] for r in found}
    for (*at, name), median in cells.items():
        native = cells.get((*at, "native"))
        if native and name not in ("native", "auto"):
            print(f"{at[0]:17}{at[1]:8} {at[2]:5}x{at[3]:<5} native is {median / native:7.1f} times as fast as {name}")


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
        axes.set_xticks(counts := sorted({r["gaussians"] for r in found}), [f"{n:,}" for n in counts])
        axes.minorticks_off()
        axes.grid(True, alpha=0.3)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--patience", type=float, default=10.0, help="seconds a single picture may take")
    parser.add_argument("--reference", action="store_true", help="and the tests' plain reference, once (a minute)")
    parser.add_argument("--quick", action="store_true", help="only 200,000 Gaussians at 512x512 and 1024x1024")
    arguments = parser.parse_args()
    arguments.counts = (200_000,) if arguments.quick else COUNTS
    arguments.sizes = ((512, 512), (1024, 1024)) if arguments.quick else SIZES
    load_plugins()
    native = nl.available()[0]
    if native:
        print(f"native: {nl.instruction_set()}, {nl.threads()} threads")
        print("accuracy:", {k: float(f"{v:.3g}") for k, v in accuracy().items()}, flush=True)
    found = rows(arguments)
    if arguments.reference:
        found.append(reference_row())
        print(describe(found[-1]), flush=True)
    plain = list(found)
    if native:
        found += native_rows(arguments.seconds)
    found.append(skinning_row(arguments.seconds))
    print(f"skinning of 200,000 points: {found[-1]['median_ms']:.2f} ms [{found[-1]['p10_ms']:.2f}]")
    print_ratios(plain)
    if arguments.json:
        write_json(arguments.json, found)
    if arguments.figure:
        draw(plain, arguments.figure)


if __name__ == "__main__":
    main()
