"""What a preset costs here: seconds a step of each stage and peak memory, over a few steps on a capture.

python benchmarks/preset_cost.py experiment=paper capture=DIR --steps 6
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from gavatar.config import compose_config
from gavatar.demo import demo_capture
from gavatar.training.run import train
from gavatar.training.stage import Stage


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=6, help="steps a stage")
    parser.add_argument("--json", metavar="FILE", help="also write the result as JSON")
    arguments, overrides = parser.parse_known_args()
    if not any(o.startswith("capture=") for o in overrides):
        overrides.append(f"capture={demo_capture()}")
    seconds: dict[int, list[float]] = {1: [], 2: []}
    original = Stage.step

    def timed(self, step):
        start = time.perf_counter()
        result = original(self, step)
        seconds[self.plan.number].append(time.perf_counter() - start)
        return result

    Stage.step = timed
    with tempfile.TemporaryDirectory() as out:
        steps = [f"stage{n}.steps={arguments.steps}" for n in (1, 2)]
        trainer = train(compose_config([*overrides, *steps, f"out={out}/run", "progress=false"]), Path(out) / "run")
        gaussians = len(trainer.scene.avatar.surface)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    # the first step of a stage loads and allocates; it is not what training costs
    result = {f"stage{n}_s_per_step": round(float(np.median(v[1:])), 2) for n, v in seconds.items() if len(v) > 1}
    result |= {"gaussians_at_the_end": gaussians, "peak_memory_mb": round(peak), "overrides": overrides}
    print(json.dumps(result, indent=1))
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
