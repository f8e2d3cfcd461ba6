"""Whether a run was evaluated before in the same way, so that it need not be again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gavatar_runtime.version import __version__

from ..training.stage import STAGE_FILES

MEASURED = "measured"  # the key in evaluation.json


def what_is_measured(directory: Path, stage: int | None, how: Mapping[str, Any]) -> dict[str, Any]:
    """What an evaluation depends on, as plain values: the trained files themselves, the settings, the version. The
    capture is not among it: a run is of one capture."""
    trained = {}
    for number, name in STAGE_FILES.items():
        if (directory / name).exists():
            trained[str(number)] = hashlib.sha256((directory / name).read_bytes()).hexdigest()[:16]
    return {"trained": trained, "stage": stage, "version": __version__, **how}


def former_evaluation(directory: Path, place: Path, how: Mapping[str, Any]) -> dict[str, Any] | None:
    """The evaluation.json in `place` if it is of what the run holds now, measured as `how` says: keywords of
    `evaluate_one`. None otherwise."""
    try:
        written = json.loads((place / "evaluation.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    settings = {name: value for name, value in how.items() if name != "stage"}
    wanted = what_is_measured(directory, how.get("stage"), settings)
    if not isinstance(written, dict) or written.get(MEASURED) != json.loads(json.dumps(wanted)):
        return None
    return written if wanted["trained"] else None
