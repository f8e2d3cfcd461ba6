"""What training found out about its footage and decided, as it stands in metrics.json."""

from __future__ import annotations

import dataclasses
from typing import Any


@dataclasses.dataclass(frozen=True)
class Look:
    """How an avatar looks in the views that judge dynamics and in a motion that nobody filmed. errors: mean squared
    errors of those views. distances: perceptual ones, None where the network for them is not installed. detail: mean
    square of what is finer than a few pixels, in the motion."""

    errors: list[float]
    distances: list[float] | None
    detail: float


@dataclasses.dataclass(frozen=True)
class DynamicsVerdict:
    """Whether dynamics pay. gain_db: mean gain in PSNR over the static avatar, on `views` views; standard_error_db: of
    that mean, None for one view. worst_gain_db: of the worst view of the one over the worst of the other.
    perceptual_ratio: mean perceptual distance over the static avatar's. detail_ratio: the same of the detail that a
    motion shows which nobody filmed. None is what was not measured. against: what spoke against them."""

    kept: bool
    gain_db: float
    standard_error_db: float | None
    views: int
    worst_gain_db: float | None = None
    perceptual_ratio: float | None = None
    detail_ratio: float | None = None
    against: list[str] = dataclasses.field(default_factory=list)

    def sentence(self) -> str:
        """For people."""
        said = [f"{self.gain_db:+.2f} dB in the mean"]
        if self.worst_gain_db is not None:
            said.append(f"{self.worst_gain_db:+.2f} dB in the worst")
        if self.perceptual_ratio is not None:
            said.append(f"{100 * (self.perceptual_ratio - 1):+.0f} % perceptual distance")
        text = f"dynamics: {', '.join(said)} on {self.views} views in poses that they did not learn from"
        if self.detail_ratio is not None:
            text += f", {100 * self.detail_ratio:.0f} % of the detail in a motion that nobody filmed"
        if self.kept:
            return f"{text}: kept"
        return f"{text}: refused ({', '.join(self.against)}), the avatar is the static one of stage 1"


@dataclasses.dataclass(frozen=True)
class ResidualVerdict:
    """What of the colours changes with the pose. fine_rms: root mean square of the part finer than 5 cm on the body, of
    the range of colours. beyond: share of points whose colour leaves its filmed range in a motion that nobody filmed.
    """

    fine_rms: float
    beyond: float


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

    static_look: of the avatar of stage 1, which stage 2 has to surpass. residual: what stage 2 made of the pose.
    frames_mended: those whose pose was replaced. frames_kept_as_estimated: those whose refined pose was refused, in
    stage 1 and in stage 2.
    choices: by the setting that was left to `auto`.
    """

    betas: ShapeVerdict | None = None
    static_look: Look | None = None
    residual: ResidualVerdict | None = None
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
        """What `as_json` made plain; what earlier versions wrote beside it is left out."""
        fields = {field.name for field in dataclasses.fields(Verdicts)}
        kinds: dict[str, Any] = {
            "static_look": Look,
            "residual": ResidualVerdict,
            "betas": ShapeVerdict,
            "dynamics": DynamicsVerdict,
            "unseen": FillingVerdict,
        }
        choices = {name: Choice(**value) for name, value in values.get("choices", {}).items()}
        known = {name: value for name, value in values.items() if name in fields and name != "choices"}
        known = {name: kinds[name](**v) if name in kinds else v for name, v in known.items()}
        return Verdicts(**known, choices=choices or None)
