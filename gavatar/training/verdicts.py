"""What training found out about its footage and decided, as it stands in metrics.json."""

from __future__ import annotations

import dataclasses
from typing import Any


@dataclasses.dataclass(frozen=True)
class DynamicsVerdict:
    """Whether dynamics pay. gain_db: mean gain in PSNR over `views` views; standard_error_db: of that mean, None for
    one view."""

    kept: bool
    gain_db: float
    standard_error_db: float | None
    views: int


@dataclasses.dataclass(frozen=True)
class ShapeVerdict:
    """Shape coefficients before and after training."""

    estimated: list[float]
    refined: list[float]


@dataclasses.dataclass(frozen=True)
class FillingVerdict:
    """points: that no training view saw. of: all points. filled: how many of the unseen took on their surroundings."""

    points: int
    of: int
    filled: int


@dataclasses.dataclass(frozen=True)
class Choice:
    """What `auto` became. value: of the setting. measured: the number that decided it, None where the footage did not
    tell. sentence: what was found and done, in words."""

    value: float | bool
    measured: float | None
    sentence: str


@dataclasses.dataclass
class Verdicts:
    """All that a training decided; None is what it had not to decide, or has not yet.

    static_errors: mean squared errors of the avatar of stage 1 in the views that judge stage 2. frames_mended: those
    whose pose was replaced. frames_kept_as_estimated: those whose refined pose was refused, in stage 1 and in stage 2.
    choices: by the setting that was left to `auto`.
    """

    betas: ShapeVerdict | None = None
    static_errors: list[float] | None = None
    dynamics: DynamicsVerdict | None = None
    frames_mended: list[int] | None = None
    frames_kept_as_estimated: list[int] | None = None
    frames_kept_as_estimated_stage2: list[int] | None = None
    unseen: FillingVerdict | None = None
    choices: dict[str, Choice] | None = None

    def chose(self, setting: str, choice: Choice) -> None:
        """Note what the setting became."""
        self.choices = {**(self.choices or {}), setting: choice}

    def as_json(self) -> dict[str, Any]:
        """Plain values of what was decided."""
        return {name: value for name, value in dataclasses.asdict(self).items() if value is not None}

    @staticmethod
    def from_json(values: dict[str, Any]) -> Verdicts:
        """What `as_json` made plain."""
        kinds = {"betas": ShapeVerdict, "dynamics": DynamicsVerdict, "unseen": FillingVerdict}
        choices = {name: Choice(**value) for name, value in values.get("choices", {}).items()}
        known = {name: kinds[name](**v) if name in kinds else v for name, v in values.items() if name != "choices"}
        return Verdicts(**known, choices=choices or None)
