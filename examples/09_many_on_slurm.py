"""An avatar of each capture, on SLURM: python examples/09_many_on_slurm.py runs 'captures/*' experiment=demo

Without SLURM the jobs run on this machine. Give the same command again after a failure: what is done is kept.
"""

import subprocess
import sys
from pathlib import Path

import submitit


class Avatar:
    """Trains and scores one avatar. A job that is preempted is put in the queue again by submitit, and continues."""

    def __init__(self, capture, run, settings):
        self.train = [sys.executable, "-m", "gavatar.cli.train", f"capture={capture}", f"out={run}", *settings]
        self.score = [sys.executable, "-m", "gavatar.cli.evaluate", str(run), "--no-fit"]

    def __call__(self):
        return subprocess.call(self.train) or subprocess.call(self.score)

    def checkpoint(self):
        return submitit.helpers.DelayedSubmission(self)


out, pattern, *settings = sys.argv[1:]
executor = submitit.AutoExecutor(folder=f"{out}/jobs")
executor.update_parameters(timeout_min=60, cpus_per_task=1, mem_gb=4, slurm_array_parallelism=256)
captures = sorted(Path().glob(pattern))
with executor.batch():  # one array of jobs
    jobs = [executor.submit(Avatar(capture, Path(out, capture.name), settings)) for capture in captures]
codes = []
for capture, job in zip(captures, jobs, strict=True):
    error = job.exception()  # waits; of a job whose process was lost, say so
    codes.append(1 if error else job.result())
    print(f"{capture}: {'lost' if error else f'exit code {codes[-1]}'}, log {job.paths.stderr}")
subprocess.call([sys.executable, "-m", "gavatar.cli.evaluate", "--all", out, "--no-fit"])
sys.exit(max(map(abs, codes), default=2))
