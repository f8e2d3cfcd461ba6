"""Seconds a training step and where they go, by the number of Gaussians, for both stages.

python benchmarks/training_step.py capture=DIR experiment=default --gaussians 13000,51000 --steps 5 --json steps.json

Atlas sides 141, 284 and 568 give about 12,500, 50,000 and 200,000 Gaussians on the free body. Medians over the steps
after the first. Overrides set everything else (stage1.batch, device, rasterizer).
"""

from __future__ import annotations

import argparse
import functools
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import gavatar  # noqa: F401  isort: skip  (before torch, which reads at once how its threads are to wait)
import numpy as np
import torch

from gavatar.config import check, compose_config
from gavatar.demo import demo_capture
from gavatar.storage import write_json
from gavatar.text_table import format_table
from gavatar.training.footage import Footage
from gavatar.training.stage import Stage
from gavatar.training.trainer import Trainer
from gavatar_runtime.errors import exit_cleanly

PARTS = ["images", "encoder", "decoder", "skinning", "splatting", "losses", "backward", "optimiser", "rest"]


class Clock:
    """Adds up the time spent in wrapped functions, a step at a time; on a CUDA device each part is waited for."""

    def __init__(self, device: torch.device):
        self.cuda = device.type == "cuda"
        self.parts: dict[str, float] = defaultdict(float)

    def now(self) -> float:
        if self.cuda:
            torch.cuda.synchronize()
        return time.perf_counter()

    def wrap(self, owner, name: str, part: str) -> None:
        function = getattr(owner, name)

        @functools.wraps(function)
        def timed(*args, **kwargs):
            start = self.now()
            try:
                return function(*args, **kwargs)
            finally:
                self.parts[part] += self.now() - start

        setattr(owner, name, timed)


def measure(overrides: list[str], gaussians: int, steps: int, folder: Path) -> list[dict]:
    """One row a stage: median seconds of a step and of its parts."""
    image = next((o.split("=")[1] for o in overrides if o.startswith("image=")), "1.0")
    levels = [f"stage{n}.levels=[{{until: 1.0, gaussians: {gaussians}, image: {image}}}]" for n in (1, 2)]
    plain = [o for o in overrides if not o.startswith("image=")]
    config = compose_config([*plain, *levels, f"out={folder}", "progress=false", "preview_every=1000000"])
    trainer = Trainer(check(config), folder)
    folder.mkdir(parents=True, exist_ok=True)
    scene, clock = trainer.scene, Clock(trainer.scene.device)
    clock.wrap(scene.avatar, "encode", "encoder")
    clock.wrap(scene.avatar, "attributes", "decoder")
    clock.wrap(scene.avatar, "pose", "skinning")
    clock.wrap(scene, "rasterize", "splatting")
    clock.wrap(trainer, "losses", "losses")
    clock.wrap(trainer.poses.optimizer, "step", "optimiser")
    batch, backward = Footage.batch, torch.Tensor.backward
    clock.wrap(Footage, "batch", "images")
    clock.wrap(torch.Tensor, "backward", "backward")
    try:
        return [_stage(trainer.stage(plan.number), clock, steps) for plan in trainer.plans]
    finally:
        Footage.batch, torch.Tensor.backward = batch, backward


def _stage(stage: Stage, clock: Clock, steps: int) -> dict:
    clock.wrap(stage.optimizers["optimizer"], "step", "optimiser")
    avatar = stage.scene.avatar.train()
    times = []
    for step in range(steps + 1):
        clock.parts.clear()
        start = clock.now()
        stage.step(step)
        parts = dict(clock.parts)
        parts["rest"] = clock.now() - start - sum(parts.values())
        times.append({"total": clock.now() - start} | parts)
    median = {k: float(np.median([t.get(k, 0.0) for t in times[1:]])) for k in ["total", *PARTS]}
    plan = stage.plan
    about = {"stage": plan.number, "gaussians": len(avatar.surface), "batch": plan.stage.batch}
    return about | {k: round(v, 4) for k, v in median.items()}


@exit_cleanly
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", default="13000,51000,200000", help="numbers of them (%(default)s)")
    parser.add_argument("--steps", type=int, default=5, help="timed steps a stage (%(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments, overrides = parser.parse_known_args()
    if not any(o.startswith("capture=") for o in overrides):
        overrides.append(f"capture={demo_capture()}")
    rows: list[dict] = []
    with tempfile.TemporaryDirectory() as folder:
        for gaussians in map(int, arguments.gaussians.split(",")):
            rows += measure(overrides, gaussians, arguments.steps, Path(folder) / str(gaussians))
    header = ["stage", "Gaussians", "s/step", *PARTS]
    cells = [[f"{r['stage']}, batch {r['batch']}", str(r["gaussians"]), f"{r['total']:.3f}",
              *(f"{r[p]:.3f}" for p in PARTS)] for r in rows]  # fmt: skip
    print(format_table(header, cells))
    if arguments.json:
        write_json(arguments.json, {"overrides": overrides, "threads": torch.get_num_threads(), "rows": rows})


if __name__ == "__main__":
    main()
