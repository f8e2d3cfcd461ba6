"""One training of `gavatar-train` as Hydra runs it: here, or sent by a launcher to another process or machine."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from gavatar_runtime.errors import UserError
from gavatar_runtime.notes import quiet_libraries
from gavatar_runtime.progress import lines_only

from ..config import register_configs
from ..storage import write_json
from ..training.run import train
from .job_record import JobRecord

DONE, CRASHED, MISTAKEN = 0, 1, 2  # exit codes, and what they stand for


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How a job ended. directory: of its run. code: the exit code it stands for. message: a sentence, or a traceback
    when it crashed."""

    directory: str
    code: int
    message: str = ""


@dataclasses.dataclass(frozen=True)
class Job:
    """The task that Hydra is given. names: of the swept captures' directories. outcomes: a folder into which each job
    writes how it ended, since neither launchers nor sweepers bring that back. home: the process that the command runs
    in; in another, progress is plain lines, since several may write to the same terminal."""

    names: Mapping[str, str]
    outcomes: Path
    home: int

    def __call__(self, config: DictConfig) -> None:
        """Train in Hydra's output directory. Errors are written down, not raised: other jobs go on."""
        hydra: Any = HydraConfig.get()
        directory = Path(hydra.runtime.output_dir)
        if os.getpid() != self.home:
            lines_only(os.path.relpath(directory))
        config.out = str(directory)
        if hydra.mode == RunMode.MULTIRUN:
            with JobRecord(Path(hydra.sweep.dir), directory) as record:
                outcome = _trained(config, directory)
                record.end(outcome.code, outcome.message)
        else:
            outcome = _trained(config, directory)
        if outcome.code != DONE:
            with contextlib.suppress(OSError):  # Hydra made the directory; it stays only if there is something in it
                directory.rmdir()
        number = OmegaConf.select(hydra, "job.num", throw_on_missing=False) or 0
        write_json(self.outcomes / f"{number}.json", dataclasses.asdict(outcome))

    def __reduce__(self) -> tuple[Any, ...]:
        return arrive, (dict(self.names), self.outcomes, self.home)

    def results(self) -> list[Outcome]:
        """How the jobs ended that did end, in their order."""
        files = sorted(self.outcomes.glob("*.json"), key=lambda path: int(path.stem))
        return [Outcome(**json.loads(path.read_text(encoding="utf-8"))) for path in files]


def _trained(config: DictConfig, directory: Path) -> Outcome:
    shown = os.path.relpath(directory)
    try:
        train(config, directory)
    except UserError as error:
        return Outcome(shown, MISTAKEN, str(error))
    except Exception:
        return Outcome(shown, CRASHED, traceback.format_exc())
    return Outcome(shown, DONE)


def arrive(names: Mapping[str, str], outcomes: Path, home: int) -> Job:
    """A job in the process where it is to run, with the registries and resolvers that its configuration needs. Hydra
    resolves the run's directory before it calls the job, so this happens as the job is unpickled."""
    if os.getpid() != home:
        quiet_libraries()
    register_configs()
    OmegaConf.register_new_resolver("run_name", lambda path: names[str(path)], replace=True)
    return Job(names, outcomes, home)
