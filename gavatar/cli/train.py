"""`gavatar-train capture=DIR [overrides]`: two-stage training, composed by Hydra."""

from __future__ import annotations

import contextlib
import importlib.resources
import os
import sys

from gavatar_runtime.errors import UserError, did_you_mean, exit_cleanly

from ..optional import requires_extra

USAGE = """gavatar-train: learn an avatar from a capture

  gavatar-train capture=DIR [out=RUN] [experiment=NAME] [GROUP=COMPONENT] [KEY=VALUE ...]
  gavatar-train capture=DIR --multirun decoder=mlp,upstream

examples
  gavatar-train capture=my_capture                         the default preset, run directory runs/my_capture
  gavatar-train capture=my_capture experiment=paper        the paper's settings (also: demo, default, upstream)
  gavatar-train capture=my_capture encoder=none            a static avatar, stage 1 only
  gavatar-train capture=my_capture decoder=upstream losses.perceptual=0.1 stage1.steps=2000
  gavatar-train capture=my_capture motion.enabled=false    the paper's baseline: no motion optimisation

A killed run continues when the same command is given again; overwrite=true starts afresh.
`gavatar-train --cfg job capture=DIR` prints the whole composed configuration; `gavatar-list` the components.
"""


def check_overrides(arguments: list[str]) -> None:
    """Compose every job of the command line once, so that a mistake is one sentence before anything starts."""
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    from ..config import check, compose_config
    from ..registry import BODIES, CAPTURES, DECODERS, ENCODERS, RASTERIZERS

    conf = importlib.resources.files("gavatar.conf")
    groups = {r.group: r for r in (BODIES, CAPTURES, DECODERS, ENCODERS, RASTERIZERS)}
    try:
        parsed = OverridesParser.create().parse_overrides([a for a in arguments if not a.startswith(("-", "hydra."))])
        for job in BasicSweeper.split_arguments(parsed, None)[0]:
            for override in job:
                group, _, name = override.partition("=")
                if group in groups and not (conf / group / f"{name}.yaml").is_file():
                    groups[group][name]  # raises with the choices and the nearest match
            check(compose_config(job))
    except (HydraException, OmegaConfBaseException) as error:
        raise UserError(_one_sentence(error)) from None


def _multirun(arguments: list[str]) -> list[str]:
    """The flag first, wherever it stood, and sweep directories named by what differs between the jobs alone."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    rest = [a for a in arguments if a not in ("-m", "--multirun")]
    try:
        parsed = OverridesParser.create().parse_overrides([a for a in rest if not a.startswith("-")])
    except HydraException as error:
        raise UserError(_one_sentence(error)) from None
    common = ",".join(o.get_key_element().lstrip("+~") for o in parsed if not o.is_sweep_override())
    return ["--multirun", f"hydra.job.config.override_dirname.exclude_keys=[{common}]", *rest]


def _one_sentence(error: Exception) -> str:
    """Hydra's own message, shortened to what helps, with the nearest match where a key is unknown."""
    import dataclasses
    import re

    from ..config import TrainConfig

    lines = [line.strip() for line in str(error.__cause__ or error).splitlines() if line.strip()]
    text = lines[0] if lines else type(error).__name__
    unknown = re.search(r"Key '(\w+)' is not in struct|Key '(\w+)' not in '(\w+)'", text)
    if unknown:
        key = unknown.group(1) or unknown.group(2)
        near = did_you_mean(key, [f.name for f in dataclasses.fields(TrainConfig)])
        full = next((line for line in lines if line.startswith("full_key")), "")
        where = full.removeprefix("full_key:").strip() or key
        if "." not in where:
            return f"unknown setting '{where}': {near}"
        return f"unknown setting '{where}': see the choices with gavatar-train --cfg job capture=DIR"
    return " ".join(lines[:2])


def job(config) -> None:
    """Train one composed configuration in Hydra's output directory."""
    from pathlib import Path

    from hydra.core.hydra_config import HydraConfig

    from ..training.run import train

    train(config, Path(HydraConfig.get().runtime.output_dir))


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
    import hydra
    from hydra.core.hydra_config import HydraConfig

    from ..config import register_configs

    register_configs()
    if {"-m", "--multirun"} & set(arguments):
        arguments = _multirun(arguments)
    if not any(a.startswith("-") and a not in ("-m", "--multirun") for a in arguments):
        check_overrides(arguments)
    failures: list[UserError] = []

    def guarded(config):
        try:
            job(config)
        except UserError as error:
            failures.append(error)
            print(f"error: {error}", file=sys.stderr)
            with contextlib.suppress(OSError):  # Hydra made the directory; it stays only if there is something in it
                os.rmdir(HydraConfig.get().runtime.output_dir)

    guarded.__module__ = "__main__"
    sys.argv = ["gavatar-train", *arguments]
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # a traceback here is a bug: show the whole of it
    hydra.main(version_base="1.3", config_path="pkg://gavatar.conf", config_name="train")(guarded)()
    return 2 if failures else 0


if __name__ == "__main__":
    main()
