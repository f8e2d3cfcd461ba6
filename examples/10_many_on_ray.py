"""An avatar of each capture, on Ray: python examples/10_many_on_ray.py runs 'captures/*' experiment=demo

RAY_ADDRESS names a cluster; without it Ray runs on this machine. What is done is kept when it is given again.
"""

import subprocess
import sys
from pathlib import Path

import ray


@ray.remote(num_cpus=1, max_retries=3, retry_exceptions=[ConnectionError])
def avatar(train, score, folder, log):
    """The exit code. A job whose node or process is lost is begun elsewhere, and continues from its checkpoint."""
    with open(log, "a") as file:
        for command in (train, score):
            code = subprocess.call(command, cwd=folder, stdout=file, stderr=file)
            if code < 0:  # by a signal: not a fault of the job
                raise ConnectionError(f"{log}: ended by signal {-code}")
            if code:
                return code
    return 0


out, pattern, *settings = sys.argv[1:]
Path(out, "jobs").mkdir(parents=True, exist_ok=True)
captures, python = sorted(Path().glob(pattern)), [sys.executable, "-m"]
ray.init(log_to_driver=False)
jobs = []
for capture in captures:
    train = [*python, "gavatar.cli.train", f"capture={capture}", f"out={Path(out, capture.name)}", *settings]
    score = [*python, "gavatar.cli.evaluate", str(Path(out, capture.name)), "--no-fit"]
    jobs.append(avatar.remote(train, score, str(Path.cwd()), str(Path.cwd() / out / "jobs" / f"{capture.name}.log")))
codes = [ray.get(job) for job in jobs]
for capture, code in zip(captures, codes, strict=True):
    print(f"{capture}: exit code {code}, log {out}/jobs/{capture.name}.log")
subprocess.call([*python, "gavatar.cli.evaluate", "--all", out, "--no-fit"])
sys.exit(max(codes, default=2))
