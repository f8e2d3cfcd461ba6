"""What a CUDA machine shows: python benchmarks/gpu_check.py [--wheels DIR] [--kernels FILE] [--out DIR] [--capture DIR]

In this order, within --minutes altogether: the rasterizer tests on CUDA; times of the rasterizers there, by CUDA
events; pictures and gradients of gsplat beside those of torch, whose rule is gavatar's own; playback from pose to image
that never leaves the device; training steps by number of Gaussians; some training with each rasterizer; last, in the
time that is left, the presets `default` and `paper` on --scored with their scores. A short table comes at the end;
OUT/gpu_check.json has the same and more, and OUT/gpu_check.log all output.

It needs no installation: the packages are taken from this tree, and what else the machine lacks from the wheels in
--wheels, which are unpacked into a temporary folder. gsplat compiles its kernels at first use, which takes minutes;
--kernels FILE is its extension module `csrc` built for that machine beforehand. --device cpu runs every part that a
machine without CUDA can.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COUNTS, SIZES = (12_500, 50_000, 200_000, 800_000), (512, 1024)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheels", type=Path, help="folder of wheels that the machine lacks")
    parser.add_argument("--kernels", type=Path, help="gsplat's kernels, built for this machine")
    parser.add_argument("--out", type=Path, default=Path(os.environ.get("OUT", "gpu_check")))
    parser.add_argument("--capture", type=Path, default=ROOT / "gavatar" / "data" / "studio_demo")
    parser.add_argument("--device", default="cuda", choices=("cuda", "cpu"))
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--scored", type=Path, help="the capture of the presets (default: --capture)")
    parser.add_argument("--steps", type=int, default=60, help="of training, with each rasterizer")
    parser.add_argument("--quick", action="store_true", help="small scenes, few steps: to try the script itself")
    parser.add_argument("--only", choices=tuple(ALONE), help="that part, in this environment as it is")
    arguments = parser.parse_args()
    if arguments.only:
        ALONE[arguments.only](arguments)
        return
    deadline = time.monotonic() + 60 * arguments.minutes
    arguments.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        checks = Checks(arguments, deadline, environment(Path(folder), arguments))
        checks.run()
    checks.report()
    sys.exit(0 if checks.fine else 1)


def environment(folder: Path, arguments) -> dict[str, str]:
    """The variables under which the tree's packages import, with the wheels unpacked in `folder`."""
    site, layout = folder / "site", folder / "layout"
    site.mkdir()
    for wheel in sorted(arguments.wheels.glob("*.whl")) if arguments.wheels else ():
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(site)
    if arguments.kernels:
        shutil.copy(arguments.kernels, site / "gsplat" / "csrc.so")  # where gsplat looks before it compiles
    package = layout / "gavatar"  # conf/ of the tree is gavatar.conf, as pyproject.toml says
    package.mkdir(parents=True)
    for part in (ROOT / "gavatar").iterdir():
        (package / part.name).symlink_to(part)
    (package / "conf").symlink_to(ROOT / "conf")
    paths = [layout, ROOT / "deploy", ROOT / "tests" / "support", ROOT, site]
    return {
        "TORCH_CUDA_ARCH_LIST": "9.0",
        "MAX_JOBS": str(os.cpu_count()),
        "TORCH_EXTENSIONS_DIR": str(folder / "extensions"),
        "PYTHONSAFEPATH": "1",  # the working folder is not where gavatar comes from
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONUNBUFFERED": "1",
        **os.environ,
        "PYTHONPATH": os.pathsep.join([*map(str, paths), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep),
    }


class Checks:
    """The parts, each a process of its own, so that one that fails or hangs leaves the others their time."""

    def __init__(self, arguments, deadline: float, variables: dict[str, str]):
        self.arguments, self.deadline, self.variables = arguments, deadline, variables
        self.results: dict[str, object] = {"seconds": {}}
        self.fine = True

    def run(self) -> None:
        self.machine()
        self.native_kernel()
        if self.arguments.device == "cuda":
            self.gsplat_kernels()
        self.save()
        parts = (self.tests, self.timings, self.agreement, self.playback, self.steps, self.training, self.presets)
        for part in parts:
            part()
            self.save()

    def save(self) -> None:
        path = self.arguments.out / "gpu_check.json"
        path.write_text(json.dumps(self.results, indent=1))

    def call(self, name: str, command: list[str], limit: float) -> str:
        """The output of `command`; what goes wrong is printed and remembered."""
        print(f"== {name}", flush=True)
        start = time.monotonic()
        limit = max(5.0, min(limit, self.deadline - start))
        try:
            done = subprocess.run(command, cwd=ROOT, env=self.variables, timeout=limit, text=True,
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT)  # fmt: skip
            output, code = done.stdout, done.returncode
        except subprocess.TimeoutExpired as error:
            output, code = (error.stdout or b"").decode(errors="replace"), f"stopped after {limit:.0f} s"
        self.results["seconds"][name] = round(time.monotonic() - start, 1)
        with open(self.arguments.out / "gpu_check.log", "a") as log:
            print(f"== {name}: {code or 'fine'}", output, sep="\n", file=log)
        if code:
            self.fine = False
            self.results.setdefault("failed", []).append(name)
            print(output[-3000:], f"{name}: {code}", sep="\n", flush=True)
        return output

    def python(self, name: str, code: str, limit: float) -> str:
        return self.call(name, [sys.executable, "-c", code], limit)

    def machine(self) -> None:
        output = self.python(
            "machine",
            "import sys, torch; c = torch.cuda.is_available();"
            "print(sys.version.split()[0], torch.__version__, torch.cuda.get_device_name() if c else 'no CUDA')",
            120,
        )
        self.results["machine"] = output.strip().splitlines()[-1:]

    def native_kernel(self) -> None:
        """The CPU's kernel, which the tests of `auto` and the training's loader may use; torch serves without it."""
        code = "import pathlib, setup; setup.compile_library(pathlib.Path('deploy/gavatar_runtime/_gavatar_native.so'))"
        fine = self.fine
        self.python("native kernel", code, 60)
        self.fine = fine

    def gsplat_kernels(self) -> None:
        self.python("gsplat kernels", "import gsplat.cuda._backend as b; print(b._C.__file__)", 300)

    def tests(self) -> None:
        which = (
            ["-k", self.arguments.device] if not self.arguments.quick else ["-k", f"{self.arguments.device} and one"]
        )
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-rs", "--durations=8",
                   "tests/plugins/rasterizers", *which]  # fmt: skip
        output = self.call("tests", command, 120)
        self.results["tests"] = [line for line in output.splitlines() if " passed" in line or " failed" in line][-1:]
        counts = re.findall(r"(\d+) (passed|failed|skipped|deselected)", " ".join(self.results["tests"]))
        self.results["tests counted"] = {name: int(number) for number, name in counts}
        self.results["tests failed"] = re.findall(r"^FAILED (.*)$", output, re.M)

    def part(self, name: str, limit: float) -> list[dict]:
        command = [sys.executable, str(Path(__file__).resolve()), "--only", name, "--device", self.arguments.device]
        command += ["--capture", str(self.arguments.capture)]
        output = self.call(name, command + ["--quick"] * self.arguments.quick, limit)
        return [json.loads(line) for line in output.splitlines() if line.startswith("{")]

    def timings(self) -> None:
        self.results["timings"] = self.part("timings", 75)

    def agreement(self) -> None:
        self.results["agreement"] = self.part("agreement", 40)

    def playback(self) -> None:
        self.results["playback"] = self.part("playback", 60)

    def steps(self) -> None:
        """Seconds a training step of both stages, by number of Gaussians (`training_step.py`)."""
        a, path = self.arguments, self.arguments.out / "steps.json"
        preset, counts, steps = ("demo", "1000", 1) if a.quick else ("default", "13000,51000,200000", 5)
        self.call("steps", [
            sys.executable, str(ROOT / "benchmarks" / "training_step.py"), f"capture={a.capture}", f"device={a.device}",
            f"experiment={preset}", "--gaussians", counts, "--steps", str(steps), "--json", str(path),
        ], 90)  # fmt: skip
        self.results["steps"] = json.loads(path.read_text())["rows"] if path.is_file() else []

    def presets(self) -> None:
        """Whole trainings by preset at full size, then their scores; what does not fit into the time is `failed`."""
        a, rows = self.arguments, []
        small = ["stage1.steps=2", "stage2.steps=1", "stage1.levels=[{until:1.0,gaussians:1000,image:0.25}]",
                 "stage2.levels=[{until:1.0,gaussians:1000,image:0.25}]"]  # fmt: skip
        for k, preset in enumerate(("demo",) if a.quick else ("default", "paper")):
            run = a.out / f"run_{preset}"
            left = (self.deadline - time.monotonic()) / (1 if a.quick or k else 2)  # half of it for each
            start = time.monotonic()
            self.call(f"train {preset}", [
                sys.executable, "-m", "gavatar.cli.train", f"capture={a.scored or a.capture}", f"out={run}",
                f"experiment={preset}", f"device={a.device}", "progress=false", "overwrite=true",
                *(small if a.quick else ()),
            ], left)  # fmt: skip
            row = {"preset": preset, "seconds": round(time.monotonic() - start, 1)}
            if (run / "metrics.json").is_file():
                self.call(f"scores {preset}", [sys.executable, "-m", "gavatar.cli.evaluate", str(run), "--no-fit",
                                               *(["--no-perceptual"] if a.quick else ())], 120)  # fmt: skip
                row["gaussians"] = json.loads((run / "metrics.json").read_text())["gaussians"]
            if (run / "evaluation.json").is_file():
                row["scores"] = json.loads((run / "evaluation.json").read_text())["rows"]
            rows.append(row)
            shutil.rmtree(run, ignore_errors=True)
        self.results["presets"] = rows

    def training(self) -> None:
        """Steps of stage 1 on whole images, no coarse levels: what the finest level costs."""
        steps, gaussians = (2, 3000) if self.arguments.quick else (self.arguments.steps, 163_000)
        names = ("gsplat", "torch") if self.arguments.device == "cuda" else ("native", "torch")
        rows = []
        for name in names:
            run = self.arguments.out / f"run_{name}"
            self.call(f"training {name}", [
                sys.executable, "-m", "gavatar.cli.train", f"capture={self.arguments.capture}", f"out={run}",
                f"rasterizer={name}", f"device={self.arguments.device}", "encoder=none", f"stage1.steps={steps}",
                "stage1.batch=2", f"stage1.levels=[{{until:1.0,gaussians:{gaussians},image:1.0}}]", "progress=false",
                "preview_every=100000", "checkpoint_every=100000", "overwrite=true", "losses=demo",
            ], 60)  # fmt: skip
            if (run / "metrics.json").is_file():
                metrics = json.loads((run / "metrics.json").read_text())
                losses = [entry["losses"] for entry in metrics["history"]]
                row = {"rasterizer": name, "gaussians": metrics["gaussians"], "steps": steps}
                rows.append(row | {"seconds": metrics["seconds"]["stage1"], "first": losses[:1], "last": losses[-1:]})
            shutil.rmtree(run, ignore_errors=True)
        self.results["training"] = rows

    def report(self) -> None:
        r = self.results
        print("\n==", *r["machine"], "|", *r.get("tests", []), "|", r["seconds"])
        for failed in r.get("tests failed", []):
            print("FAILED", failed)
        if r.get("timings"):
            print(f"{'median ms':12}{'Gaussians':>10}{'size':>6}{'forward':>10}{'forward+backward':>18}")
        for row in r.get("timings", []):
            print(f"{row['rasterizer']:12}{row['gaussians']:10}{row['size']:6}{row['forward_ms']:10.3f}"
                  f"{row['forward_backward_ms']:18.3f}")  # fmt: skip
        for row in r.get("agreement", []):
            print(json.dumps(row))
        for row in r.get("playback", []):
            print(f"playback {row['rasterizer']}: {row['gaussians']} Gaussians at {row['size']}, "
                  f"{row['frame_ms']:.2f} ms from pose to image")  # fmt: skip
        for row in r.get("steps", []):
            print(f"a step of stage {row['stage']}: {row['gaussians']} Gaussians, {row['total']} s")
        for row in r.get("presets", []):
            print("preset", json.dumps(row))
        for row in r.get("training", []):
            print(f"training {row['rasterizer']}: {row['gaussians']} Gaussians, {row['steps']} steps in "
                  f"{row['seconds']} s")  # fmt: skip


def _scene(count: int, device: str):
    from splat_scenes import as_torch, body_scene

    from gavatar_runtime.values.gaussians import Gaussians

    fields = vars(as_torch(body_scene(count))).items()
    return Gaussians(**{k: None if v is None else v.to(device).requires_grad_() for k, v in fields})


def _rasterizers(device: str) -> dict:
    from gavatar.registry import RASTERIZERS, load_plugins

    load_plugins()
    return {
        name: RASTERIZERS.build(name) for name in (("gsplat", "torch") if device == "cuda" else ("native", "torch"))
    }


def print_timings(arguments) -> None:
    """A JSON line a cell: medians, and 10 and 90 % quantiles, over runs that last some tenths of a second together."""
    import torch
    from splat_scenes import body_camera

    counts, sizes = ((2000,), (128,)) if arguments.quick else (COUNTS, SIZES)
    for name, rasterizer in _rasterizers(arguments.device).items():
        for count in counts:
            scene = _scene(count, arguments.device)
            wanted = (scene.means, scene.scales, scene.colors)
            for size in sizes:
                camera = body_camera(size, size)
                upstream = torch.randn((size, size, 3), generator=torch.Generator().manual_seed(0))
                upstream = upstream.to(arguments.device)

                def forward(rasterizer=rasterizer, scene=scene, camera=camera):
                    with torch.no_grad():
                        rasterizer(scene, camera)

                def both(rasterizer=rasterizer, scene=scene, camera=camera, wanted=wanted, upstream=upstream):
                    torch.autograd.grad(rasterizer(scene, camera).color, wanted, upstream)

                row = {"rasterizer": name, "gaussians": count, "size": size}
                for mode, run in (("forward", forward), ("forward_backward", both)):
                    p10, median, p90 = _quantiles(run, arguments.device)
                    row |= {f"{mode}_ms": median, f"{mode}_p10_ms": p10, f"{mode}_p90_ms": p90}
                if arguments.device == "cuda":
                    row["peak_MiB"] = round(torch.cuda.max_memory_allocated() / 2**20)
                    torch.cuda.reset_peak_memory_stats()
                print(json.dumps(row), flush=True)


def _quantiles(run, device: str) -> list[float]:
    import numpy as np
    import torch

    for _ in range(2):
        run()
    times, until = [], time.perf_counter() + 0.4
    while len(times) < 3 or (time.perf_counter() < until and len(times) < 100):
        if device == "cuda":
            start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
            torch.cuda.synchronize()
            start.record()
            run()
            end.record()
            end.synchronize()
            times.append(start.elapsed_time(end))
        else:
            start = time.perf_counter()
            run()
            times.append(1e3 * (time.perf_counter() - start))
    return [round(float(q), 4) for q in np.percentile(times, (10, 50, 90))]


def print_agreement(arguments) -> None:
    """A JSON line a size and clamp: how far the first rasterizer is from torch, in float32. Clamp 0.99 is gavatar's
    rule; at gsplat's 0.999 only rounding should be left between gsplat and torch."""
    import torch
    from splat_scenes import body_camera

    from gavatar_plugins.rasterizers import torch_tiles

    mine, reference = _rasterizers(arguments.device).values()

    def draw(rasterizer, count: int, size: int):
        scene = _scene(count, arguments.device)
        picture = rasterizer(scene, body_camera(size, size))
        upstream = torch.randn((size, size, 3), generator=torch.Generator().manual_seed(0)).to(arguments.device)
        gradients = torch.autograd.grad(picture.color, (scene.means, scene.scales, scene.colors), upstream)
        return picture.color.detach().double(), [g.double() for g in gradients]

    for count, size in ((2000, 128),) if arguments.quick else ((12_500, 512), (200_000, 512), (200_000, 1024)):
        picture, gradients = draw(mine, count, size)
        for clamp in (0.99, 0.999):
            torch_tiles.ALPHA_MAX = clamp
            exact, exact_gradients = draw(reference, count, size)
            error = (picture - exact).abs()
            row = {"gaussians": count, "size": size, "clamp": clamp}
            row |= {"psnr_db": float(-10 * error.square().mean().log10()), "largest": float(error.max())}
            row["over_2_255"] = float((error.amax(-1) > 2 / 255).double().mean())
            for name, a, b in zip(("means", "scales", "colors"), gradients, exact_gradients, strict=True):
                row[f"gradient_{name}"] = float((a - b).norm() / b.norm())
            print(json.dumps(row), flush=True)


def print_playback(arguments) -> None:
    """A JSON line a size: an avatar of the preset `default`, untrained, from a pose on the device to an image on the
    device: encoder, decoder, skinning and drawing. The encoder's maps of the body come from the host beforehand."""
    import tempfile

    import torch

    from gavatar.config import check, compose_config
    from gavatar.training.trainer import Trainer

    device = arguments.device
    preset, gaussians, sizes = ("demo", 1000, (64,)) if arguments.quick else ("default", 200_000, (512, 1024))
    name = "gsplat" if device == "cuda" else "native"
    level = f"levels=[{{until: 1.0, gaussians: {gaussians}, image: 1.0}}]"
    with tempfile.TemporaryDirectory() as folder:
        overrides = [f"capture={arguments.capture}", f"experiment={preset}", f"device={device}", f"rasterizer={name}",
                     f"stage1.{level}", f"stage2.{level}", f"out={folder}", "progress=false"]  # fmt: skip
        trainer = Trainer(check(compose_config(overrides)), Path(folder))
    scene, plan = trainer.scene, trainer.plans[-1]
    scene.place(plan.stage.levels[-1])
    avatar, frames = scene.avatar.eval(), scene.frames[:8]
    camera = scene.footage.at(1.0).cameras[0]
    moving = avatar.encoder is not None
    inputs = {frame: scene.encoder_inputs([frame]) if moving else [] for frame in frames}
    for size in sizes:
        seen, calls = camera.resized(size, size), iter(range(1 << 30))

        @torch.no_grad()
        def frame(seen=seen, calls=calls):
            at = frames[next(calls) % len(frames)]
            features = avatar.encode(*inputs[at]) if moving else None
            return scene.draw(avatar.attributes(features), scene.motion([at]), [seen])

        if str(frame()[0].device.type) != device:
            raise SystemExit(f"the image is on {frame()[0].device}, not on {device}")
        p10, median, p90 = _quantiles(frame, device)
        row = {"rasterizer": name, "gaussians": len(avatar.surface), "size": size, "dynamic": moving}
        print(json.dumps(row | {"frame_ms": median, "p10_ms": p10, "p90_ms": p90}), flush=True)


ALONE = {"timings": print_timings, "agreement": print_agreement, "playback": print_playback}

if __name__ == "__main__":
    main()
