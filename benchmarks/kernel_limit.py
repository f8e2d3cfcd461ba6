"""The compiled kernel against its limit: python benchmarks/kernel_limit.py [--against LIBRARY] [--bundle NAME.gavatar]

Prints, for a body of Gaussians (--gaussians, --size):
* each stage's bytes and operations, a stripped loop of it (`limit_loops.cpp`, built here) and how near the kernel is;
* forward and with backward for 1 and all threads, up to 800,000 Gaussians, beside those of another build of the kernel
  (--against, `setup.compile_library`), taking turns in this process;
* how many Gaussians each rasterizer draws at 30, 60 and 120 frames a second, and, of a bundle, each tier.
--parts picks some of these. Stages are processor time of the
fastest calls, which other work on the machine disturbs least; all else are medians; --seconds each.
"""

from __future__ import annotations

import argparse
import ctypes
import functools
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / "support"), str(ROOT / "benchmarks")]

import splatting  # noqa: E402
from splat_scenes import as_numpy, body_camera, body_scene  # noqa: E402

from gavatar.registry import load_plugins  # noqa: E402
from gavatar_runtime import native_library as nl  # noqa: E402
from gavatar_runtime.render.choice import player_rasterizers  # noqa: E402

RATES = (30, 60, 120)
RECORD, ENTRY, READ = 32, 8, 28  # bytes of a record, of an entry, and of a Gaussian's position, colour and scale
PASSES = 4  # over the entries: nearest and farthest, counts, the move's reading and writing
BLEND_OPS, BACKWARD_OPS = 20, 45  # multiply-adds of 16 lanes a pair of Gaussian and block, of the forward and of both
LOOPS = Path(__file__).with_name("limit_loops.cpp")


@functools.cache
def loops() -> ctypes.CDLL:
    """The stripped loops, compiled for this processor."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "loops.so")
        flags = ["-std=c++17", "-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math",
                 "-w", "-shared", "-fPIC"]  # fmt: skip
        subprocess.check_call([os.environ.get("CXX", "g++"), *flags, str(LOOPS), "-o", str(target)])
        library = ctypes.CDLL(str(target))
    for name in ("multiply_adds", "project", "order", "blend"):
        getattr(library, f"limit_{name}").restype = ctypes.c_double
    return library


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def copied_bytes_a_second(size: int = 1 << 26) -> float:
    """Bytes read and written a second by a copy of arrays that no core's cache holds."""
    source, target = np.ones(size // 4, np.float32), np.zeros(size // 4, np.float32)
    return 2 * size / best(lambda: np.copyto(target, source))


def best(run, turns: int = 7) -> float:
    """Seconds of processor time of the fastest of some calls."""
    times = []
    for _ in range(turns):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return min(times)


def projected(scene, camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Records (N, 8) as the kernel's, depths (N,) and half sizes (N, 2) of their boxes, pixels; isotropic Gaussians."""
    R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
    x, y, z = R @ scene.means.T.astype(np.float64) + t[:, None]
    tx, ty = x / z, y / z
    variance = (scene.scales / z * camera.fx) ** 2
    A, B, C = variance * (1 + tx**2) + 0.3, variance * tx * ty, variance * (1 + ty**2) + 0.3
    half = 0.5 / np.log(2)
    sy = np.sqrt(half * A / (A * C - B * B))
    shape = (camera.fx * tx + camera.cx - 0.5, camera.fy * ty + camera.cy - 0.5, np.sqrt(half / A), sy, -sy * B / A)
    reach = 2 * np.log(255)
    records = np.stack([*shape, *scene.colors.T], 1).astype(np.float32)
    return records, z, np.sqrt(reach * np.stack([A, C], 1))


def by_block(records: np.ndarray, depth: np.ndarray, half: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Where each 4x4 block's records begin (blocks + 1,), and the records (M, 8) block after block, front to back."""
    side = -(-size // 4)
    low = np.clip(np.ceil(records[:, :2] - half), 0, size - 1).astype(int) // 4
    high = np.clip(np.floor(records[:, :2] + half), 0, size - 1).astype(int) // 4
    wide, tall = (high - low + 1).T
    row = np.repeat(np.arange(len(records)), wide * tall)
    place = np.arange(len(row)) - np.repeat(np.cumsum(wide * tall) - wide * tall, wide * tall)
    bx, by = low[row, 0] + place % wide[row], low[row, 1] + place // wide[row]
    block = by * side + bx
    order = np.lexsort((depth[row], block))
    found = records[row[order]]
    found[:, 0] -= 4 * bx[order]
    found[:, 1] -= 4 * by[order]
    first = np.concatenate([[0], np.cumsum(np.bincount(block, minlength=side * side))]).astype(np.int64)
    return first, np.ascontiguousarray(found)


def limits(count: int, size: int) -> dict[str, dict[str, float]]:
    """By stage: bytes, operations (multiply-adds of 16 lanes), stripped_ms of one thread; `machine` has its rates."""
    scene, camera, library = as_numpy(body_scene(count)), body_camera(size, size), loops()
    bandwidth = copied_bytes_a_second()
    rate = max(library.limit_multiply_adds(ctypes.c_int64(2_000_000)) for _ in range(5))
    T = camera.T_camera_world
    numbers = np.array([*T[:3, :3].ravel(), *T[:3, 3], camera.fx], np.float32)
    made = np.zeros((count, 8), np.float32)
    arrays = [pointer(a) for a in (scene.means, scene.colors, scene.scales, numbers, made)]
    project_s = min(library.limit_project(ctypes.c_int64(count), *arrays) for _ in range(7))
    first, records = by_block(*projected(scene, camera), size)
    image, pairs = np.zeros(len(first) * 48, np.float32), ctypes.c_int64()
    given = [pointer(a) for a in (first, records, image)]
    blend_s = min(library.limit_blend(ctypes.c_int64(len(first) - 1), *given, ctypes.byref(pairs)) for _ in range(7))
    kernel = player_rasterizers().build("native", {"threads": 1, "depth": False})
    kernel.render_uint8(scene, camera)
    entries = kernel.entries
    places = np.random.default_rng(0).integers(0, 4096, entries).astype(np.uint64) << np.uint64(32)
    out = np.zeros_like(places)
    order_s = min(library.limit_order(ctypes.c_int64(entries), pointer(places), 4096, pointer(out)) for _ in range(7))
    blend, handled = pairs.value * BLEND_OPS, count * (READ + RECORD) + entries * ENTRY
    return {
        "machine": {"copy_GB_s": bandwidth / 1e9, "multiply_adds_G_s": rate / 1e9},
        "project": {"bytes": handled, "operations": 0, "stripped_ms": 1e3 * project_s},
        "sort": {"bytes": entries * ENTRY * PASSES, "operations": 0, "stripped_ms": 1e3 * order_s},
        "blend": {"bytes": pairs.value * RECORD, "operations": blend, "stripped_ms": 1e3 * blend_s},
        "backward": {"bytes": pairs.value * RECORD * 2, "operations": pairs.value * BACKWARD_OPS, "stripped_ms": 0.0},
    }  # fmt: skip


def stages(count: int, size: int, seconds: float) -> dict[str, float]:
    """Milliseconds of the kernel's stages and of the backward, one thread, of processor time: the fastest picture, by
    the median share of each stage of its wall time."""
    rasterizer, run = splatting.forward_run("native", {"threads": 1, "depth": False}, count, body_camera(size, size))
    shares, until = [], time.perf_counter() + seconds
    forward = best(run)
    while len(shares) < 5 or time.perf_counter() < until:
        forward = min(forward, best(run, 1))
        stage = rasterizer.stage_seconds
        shares.append([value / sum(stage.values()) for value in stage.values()])
    found = dict(zip(stage, 1e3 * forward * np.median(shares, 0), strict=True))
    _, both = splatting.backward_run("native", {"threads": 1}, count, body_camera(size, size))
    return {**found, "backward": 1e3 * (best(both, max(7, int(20 * seconds))) - forward)}


def print_limits(count: int, size: int, seconds: float) -> None:
    found, kernel = limits(count, size), stages(count, size, seconds)
    machine = found.pop("machine")
    print(f"one thread: copies {machine['copy_GB_s']:.1f} GB/s, {machine['multiply_adds_G_s']:.2f} billion "
          f"multiply-adds of 16 lanes a second; {count:,} Gaussians, {size}x{size}")  # fmt: skip
    print("| stage | MB moved | of memory ms | million operations | of arithmetic ms | stripped loop ms | kernel ms "
          "| kernel / stripped | kernel / rates |\n|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    for name, row in found.items():
        moved, worked = (
            row["bytes"] / machine["copy_GB_s"] / 1e6,
            row["operations"] / machine["multiply_adds_G_s"] / 1e6,
        )
        stripped, ms = row["stripped_ms"], kernel[name]
        beside = f"{stripped:.2f} | {ms:.2f} | {ms / stripped:.1f}" if stripped else f"- | {ms:.2f} | -"
        print(
            f"| {name} | {row['bytes'] / 1e6:.1f} | {moved:.2f} | {row['operations'] / 1e6:.1f} | {worked:.2f} "
            f"| {beside} | {ms / max(moved, worked):.1f} |",
            flush=True,
        )


def with_library(path: Path | None) -> None:
    """From now on rasterizers that are built use the kernel at `path`, None for that of the tree."""
    os.environ["GAVATAR_NATIVE_LIBRARY"] = str(path.resolve()) if path else ""
    nl._load.cache_clear()


def turns(runs: dict, seconds: float) -> dict[str, tuple[float, float]]:
    """Median and fastest milliseconds of calls that take turns."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        run()
    until = time.perf_counter() + seconds
    while min(map(len, times.values())) < 5 or time.perf_counter() < until:
        for name, run in runs.items():
            start = time.perf_counter()
            run()
            times[name].append(1e3 * (time.perf_counter() - start))
    return {name: (float(np.median(t)), min(t)) for name, t in times.items()}


VARIANTS = {"exact": {}, "fast": {"fast": True}, "fast, backface 0.5": {"fast": True, "backface": 0.5}}


def print_variants(against: Path | None, counts, sizes, threads, seconds: float) -> None:
    """Playback's forward by switches, and that of the other build, in turns, with PSNR against the exact picture."""
    print(
        "\n| Gaussians | size | threads | kernel | ms | fastest ms | ratio to the first | of fastest | PSNR dB |"
        "\n|---|---|---|---|---|---|---|---|---|"
    )
    for count in counts:
        scene = as_numpy(body_scene(count))
        for size in sizes:
            camera = body_camera(size, size)
            for cores in threads:
                runs = {}
                for library in [against, None] if against else [None]:
                    with_library(library)
                    for name, options in VARIANTS.items():
                        if library and options:
                            continue
                        kernel = player_rasterizers().build("native", {"threads": cores, "depth": False, **options})
                        label = "other build, exact" if library else name
                        runs[label] = functools.partial(kernel.render_uint8, scene, camera)
                medians = turns(runs, seconds)
                first = next(iter(medians.values()))
                exact = player_rasterizers().build("native").render(scene, camera).color.copy()
                for name, (median, least) in medians.items():
                    options = VARIANTS.get(name, {})
                    drawn = player_rasterizers().build("native", options).render(scene, camera).color
                    error = splatting.psnr(drawn, exact)
                    print(f"| {count:,} | {size} | {cores} | {name} | {median:.2f} | {least:.2f} "
                          f"| {first[0] / median:.2f} | {first[1] / least:.2f} "
                          f"| {'same' if error is None else f'{error:.0f}'} |", flush=True)  # fmt: skip


def most_in_time(counts, milliseconds, budget: float) -> str:
    """The largest count within a budget of milliseconds, on lines between the measured ones in logarithms."""
    if milliseconds[0] > budget:
        return f"< {counts[0]:,}"
    if max(milliseconds) <= budget:
        return f"> {counts[-1]:,}"
    k = next(k for k, ms in enumerate(milliseconds) if ms > budget)
    x = np.interp(np.log(budget), np.log(milliseconds[k - 1 : k + 1]), np.log(counts[k - 1 : k + 1]))
    return f"{round(float(np.exp(x)), -3):,.0f}"


def print_crossover(names, counts, sizes, threads, seconds: float, patience_ms: float = 400.0) -> None:
    """The most Gaussians that each rasterizer draws in time."""
    print(f"\n| rasterizer | size | threads | {' | '.join(f'{r} fps' for r in RATES)} |\n|---|---|---|---|---|---|")
    for name in names:
        for size in sizes:
            for cores in threads if name == "native" else threads[-1:]:
                measured: list[float] = []
                for count in counts:
                    measured.append(splatting.cell("forward", name, (count, size, size), seconds, cores)["median_ms"])
                    if measured[-1] > patience_ms:
                        break
                found = [most_in_time(counts[: len(measured)], measured, 1e3 / rate) for rate in RATES]
                print(f"| {name} | {size} | {cores} | {' | '.join(found)} |", flush=True)


def print_tiers(path: Path, counts, size: int, seconds: float) -> None:
    """Frames of a bundle from pose to pixels by tier and number of Gaussians, one after the other."""
    from gavatar_runtime.avatar.playing import Avatar
    from gavatar_runtime.bundle import read_bundle
    from gavatar_runtime.play.framing import frame_motion
    from gavatar_runtime.render.renderer import Renderer
    from gavatar_runtime.values.motion import Motion

    bundle = read_bundle(path)
    kinds = [tier["name"] for tier in bundle.manifest.tiers] or ["full"]
    print(f"\n| tier | Gaussians | ms at {size} | of it decode | fps |\n|---|---|---|---|---|")
    for tier in kinds:
        for seen in (False, True) if tier == "full" else (False,):
            for count in (*(n for n in counts if n < bundle.manifest.gaussians), bundle.manifest.gaussians):
                avatar = Avatar(bundle, tier=tier, gaussians=count, seen_only=seen)
                if seen and not avatar.seen_only:
                    continue
                renderer = Renderer(avatar)
                poses = np.random.default_rng(0).normal(0, 0.1, (8, len(avatar.joint_names), 3)).astype(np.float32)
                camera = frame_motion(avatar, Motion(poses, np.zeros((8, 3), np.float32), 30.0), size, size)
                turn, decode = iter(range(1 << 30)), []

                def frame(renderer=renderer, poses=poses, camera=camera, turn=turn, decode=decode):
                    drawn = renderer.gaussians(poses[next(turn) % 8], camera=camera)
                    renderer.rasterize_uint8(drawn, camera)
                    decode.append(1e3 * renderer.avatar.stage_seconds.get("decode", 0.0))

                median = splatting.measure(frame, seconds)["median_ms"]
                name = f"{tier}, seen only" if seen else tier
                print(
                    f"| {name} | {count:,} | {median:.1f} | {np.median(decode):.1f} | {1e3 / median:.0f} |", flush=True
                )


PARTS = ("limits", "variants", "crossover", "tiers")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="another build of the kernel, of the same interface")
    parser.add_argument("--bundle", type=Path)
    parser.add_argument("--gaussians", type=int, default=200_000)
    parser.add_argument("--counts", type=int, nargs="+", default=[12_500, 50_000, 200_000, 800_000])
    parser.add_argument("--sizes", type=int, nargs="+", default=[512, 1024])
    parser.add_argument("--rasterizers", nargs="+", default=["native", "numpy", "torch"])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--seconds", type=float, default=0.5)
    given = parser.parse_args(arguments)
    load_plugins()
    threads = sorted({1, 2, splatting.CORES} & set(range(1, splatting.CORES + 1)))
    if "limits" in given.parts:
        print_limits(given.gaussians, given.sizes[0], given.seconds)
    if "variants" in given.parts:
        counts = [n for n in given.counts if n >= given.gaussians] or given.counts[-1:]
        print_variants(given.against, counts, given.sizes, threads, given.seconds)
    if "crossover" in given.parts:
        print_crossover(given.rasterizers, given.counts, given.sizes, threads, given.seconds)
    if "tiers" in given.parts and given.bundle:
        print_tiers(given.bundle, given.counts, given.sizes[0], given.seconds)


if __name__ == "__main__":
    main()
