"""`gavatar-train capture=DIR [overrides]`: two-stage training, composed by Hydra."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from gavatar_runtime.errors import UserError, exit_cleanly

from ..optional import requires_extra

USAGE = """gavatar-train: learn an avatar from a capture

  gavatar-train capture=DIR [out=RUN] [experiment=NAME] [GROUP=COMPONENT] [KEY=VALUE ...]
  gavatar-train capture=DIR --multirun decoder=mlp,upstream
  gavatar-train capture='captures/*' --multirun

examples
  gavatar-train capture=my_capture                         the default preset, run directory runs/my_capture
  gavatar-train capture=my_capture experiment=paper        the paper's settings (also: demo, default, upstream)
  gavatar-train capture=my_capture encoder=none            a static avatar, stage 1 only
  gavatar-train capture=my_capture decoder=upstream losses.perceptual=0.1 stage1.steps=2000
  gavatar-train capture=my_capture motion.enabled=false    the paper's baseline: no motion optimisation

A killed run continues when the same command is given again; overwrite=true starts afresh.
`gavatar-train --cfg job capture=DIR` prints the whole composed configuration; `gavatar-list` the components.
"""


@exit_cleanly
def main(argv: list[str] | None = None) -> int:
    """Console entry point."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE)
        return 0
    return _train(arguments)


@requires_extra("train")
def _train(arguments: list[str]) -> int:
    from ..config import register_configs
    from ..overrides import check_overrides
    from .sweep import asks_for_many, refuse_pattern, sweep_arguments

    register_configs()
    names: dict[str, str] = {}
    many = asks_for_many(arguments)
    if many:
        arguments, names = sweep_arguments(arguments)
    if any(a.startswith("-") and a != "--multirun" for a in arguments):  # only asks, as --cfg does
        _hydra(arguments, print)
        return 0
    if not many:
        refuse_pattern(arguments)
    jobs = check_overrides(arguments)
    # where the runs go, which other machines see as well
    beside = Path(jobs[0].out).absolute().parent
    with _scratch_folder(beside) as folder:
        return _run_jobs(arguments, names, folder, len(jobs) if many else None)


def _run_jobs(arguments: list[str], names: dict[str, str], folder: Path, expected: int | None) -> int:
    """Let Hydra run the jobs; what went wrong goes to stderr. expected: how many, None for a single one.
    Returns the exit code of the worst."""
    from .jobs import CRASHED, MISTAKEN, arrive

    job = arrive(names, folder, os.getpid())
    _hydra(arguments, job)
    outcomes = job.results()
    for outcome in outcomes:
        if outcome.code:
            where = "" if expected is None else f"{outcome.directory}: "
            print(f"error: {where}{outcome.message}", file=sys.stderr)
    codes = {outcome.code for outcome in outcomes}
    counted = not any(a.startswith("hydra/sweeper") for a in arguments)  # another sweeper than Hydra's own may do fewer
    if expected is not None and counted and len(outcomes) < expected:
        print(f"error: {expected - len(outcomes)} of {expected} jobs ended without a result", file=sys.stderr)
        codes.add(CRASHED)
    if expected is not None:
        print(f"{sum(not outcome.code for outcome in outcomes)} of {expected} runs trained")
    return next((code for code in (CRASHED, MISTAKEN) if code in codes), 0)


def _hydra(arguments: list[str], task: Callable[..., object]) -> None:
    import hydra
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    from ..overrides import one_sentence

    sys.argv = ["gavatar-train", *arguments]
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # a traceback here is a bug: show the whole of it
    try:
        hydra.main(version_base="1.3", config_path="pkg://gavatar.conf", config_name="train")(task)()
    except (HydraException, OmegaConfBaseException) as error:  # of its own settings: those of training were checked
        raise UserError(one_sentence(error)) from None


@contextlib.contextmanager
def _scratch_folder(beside: Path) -> Iterator[Path]:
    """A folder that is gone afterwards, and so are those above it that it was the only reason for."""
    made = [path for path in (beside, *beside.parents) if not path.exists()]
    try:
        beside.mkdir(parents=True, exist_ok=True)
        folder = tempfile.mkdtemp(prefix=".gavatar-train-", dir=beside)
    except OSError as error:
        raise UserError(f"{beside} cannot be written: {error.strerror or error}") from None
    try:
        yield Path(folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        with contextlib.suppress(OSError):
            for path in made:
                path.rmdir()


if __name__ == "__main__":
    main()
