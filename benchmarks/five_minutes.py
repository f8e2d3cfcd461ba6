"""From a clip to an avatar with tiers: seconds and peak memory of each stage, and what training spends them on.

    python benchmarks/five_minutes.py clip.mp4 --out DIR --json table.json
    python benchmarks/five_minutes.py captures/anna --out DIR --scores stage1.steps=1700

FOOTAGE is what `gavatar-prepare` takes, or a capture. Further words are settings of `gavatar-train`. --scores adds the
capture's `test` and `novel_pose` splits, which take their time apart. To compare two versions, run each in its own
checkout on the same machine, one after the other. Of training, each row is what is spent there and not in another row.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections import defaultdict
from pathlib import Path

import gavatar  # isort: skip  (before torch, which reads at once how its threads are to wait)
import torch

from gavatar.overrides import from_overrides
from gavatar.storage import write_json
from gavatar.text_table import format_table
from gavatar.training import stage as stages
from gavatar.training.choosing import Chooser
from gavatar.training.footage import FootageSource
from gavatar.training.schedule import level_at

SPLITS = ("test", "novel_pose")


class Clock:
    """Seconds by name, each without what is spent in another named part inside it."""

    def __init__(self):
        self.seconds: dict[str, float] = defaultdict(float)
        self.counts: dict[str, int] = defaultdict(int)
        self._inside: list[float] = []

    def wrap(self, owner, attribute: str, name) -> None:
        """name: of the part, or a function of the call's arguments that gives it."""
        function = getattr(owner, attribute)

        @functools.wraps(function)
        def timed(*args, **kwargs):
            label = name(*args) if callable(name) else name
            self._inside.append(0.0)
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                took = time.perf_counter() - start
                self.seconds[label] += took - self._inside.pop()
                self.counts[label] += 1
                if self._inside:
                    self._inside[-1] += took

        setattr(owner, attribute, timed)


def watch(clock: Clock) -> None:
    """Have the clock measure the parts of every training from here on."""

    def step_of(stage, step) -> str:
        level = level_at(stage.plan.stage, step)
        return f"stage {stage.plan.number}, {level.gaussians or level.uv} Gaussians, images x {level.image:g}"

    clock.wrap(stages.Stage, "step", step_of)
    clock.wrap(stages.Stage, "_look", "verdict on dynamics: looks")
    clock.wrap(stages.Stage, "_fill", "evidence and prior")
    clock.wrap(stages.Stage, "_mend", "poses mended")
    clock.wrap(stages.Stage, "_prepare_encoder", "encoder prepared")
    clock.wrap(stages.Stage, "save", "checkpoints")
    clock.wrap(stages, "refuse_worse_poses", "worse poses refused")
    clock.wrap(stages, "fine_rms", "verdict on dynamics: detail")
    clock.wrap(stages, "colours_beyond", "verdict on dynamics: colours")
    clock.wrap(FootageSource, "at", "images read and sized")
    for name in ("masks", "window", "exposure", "shape"):
        clock.wrap(Chooser, name, f"auto: {name}")


def peak_mb() -> float:
    """Peak memory since `forget_peak`, of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def forget_peak() -> None:
    """Linux: the peak starts from what is in use now."""
    Path("/proc/self/clear_refs").write_text("5")


def staged(rows: list[dict], name: str, action):
    """Do it; a row of what it took."""
    forget_peak()
    start = time.perf_counter()
    result = action()
    row = {"stage": name, "seconds": round(time.perf_counter() - start, 1), "peak_mb": round(peak_mb())}
    rows.append(row)
    print(row, flush=True)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("footage", type=Path)
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, required=True, help="folder for capture, run and bundle; an empty one")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--scores", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_intermixed_args()
    rows, clock, capture = [], Clock(), options.footage
    options.out.mkdir(parents=True, exist_ok=True)
    if not (capture / "capture.json").is_file():
        capture = options.out / "capture"
        staged(rows, "prepare", lambda: gavatar.prepare(options.footage, capture, progress=False))
    watch(clock)
    settings = {"progress": False, **from_overrides(options.settings)}
    run = staged(rows, "train", lambda: gavatar.train(capture, options.preset, out=options.out / "run", **settings))
    staged(rows, "export", lambda: run.export(options.out / "me.gavatar", tiers="auto" if run.dynamic else ()))
    rows.append({"stage": "in all", "seconds": round(sum(r["seconds"] for r in rows), 1),
                 "peak_mb": max(r["peak_mb"] for r in rows)})  # fmt: skip
    print(format_table(["stage", "seconds", "peak MB"], [[r["stage"], f"{r['seconds']:.1f}", str(r["peak_mb"])]
                                                         for r in rows]))  # fmt: skip
    parts = sorted(clock.seconds.items(), key=lambda part: -part[1])
    print(format_table(["of training", "seconds", "times"], [[n, f"{s:.1f}", str(clock.counts[n])] for n, s in parts]))
    result = {"threads": torch.get_num_threads(), "gaussians": run.gaussians, "rows": rows,
              "training": {n: {"seconds": round(s, 2), "times": clock.counts[n]} for n, s in parts}}  # fmt: skip
    if options.scores:
        scores = run.evaluate(SPLITS, progress=False)
        print(scores)
        result["scores"] = str(scores)
    if options.json:
        write_json(options.json, result)


if __name__ == "__main__":
    main()
