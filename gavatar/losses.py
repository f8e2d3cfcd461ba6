"""What a loss may look at, and how losses compose.

A loss is a component of `LOSSES`: built from a dataclass that derives from `LossConfig`, called with one `LossInputs`,
it returns a scalar Tensor >= 0, reduced by the MEAN over every element, or None when what it needs is absent. Its
weight stays outside: `LossComposer` multiplies and adds.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

from gavatar_runtime.errors import UserError

from .registry import LOSSES, LossTraits, load_plugins


@dataclasses.dataclass(kw_only=True)
class MotionState:
    """The motion of ALL training frames in time order, as matrices, so that no loss meets an axis-angle wrap.

    rotations, rotations_initial: (T, J, 3, 3) local joint rotations, now and before training.
    trans, trans_initial: (T, 3) metres. frame_times: (T,) seconds, increasing, with gaps where frames are held out.
    The initial values carry no gradient. betas_change: (n,) shape coefficients less their estimate, None where the
    shape is fixed.
    """

    rotations: Tensor
    rotations_initial: Tensor
    trans: Tensor
    trans_initial: Tensor
    frame_times: Tensor
    betas_change: Tensor | None = None


@dataclasses.dataclass(kw_only=True)
class LossInputs:
    """Everything a loss may look at in one training step; what is absent is None.

    render: (B, 3, H, W) composited over the batch's background, [0, 1]. target: (B, 3, H, W) footage over the same
    background. alpha: (B, H, W) rendered. mask: (B, H, W) footage alpha in [0, 1].
    features: (1, C, R, R) learnable feature tensor. pose_features: (B, C, R, R). pose_detail: (B, M, 3) what of the
    colours' change with the pose is finer than 5 cm on the body, at some of the points. to_neighbours: (B or 1, N, 7 or
    more) colours, offsets in centimetres and scales in spacings, less those of one of the points next to each on the
    body, absent while the look stands still. offsets: (B or 1, N, 3) metres. scales: (B or 1, N) or (B or 1, N, 3)
    metres. motion: the pose table, absent when poses are fixed. progress: 0..1 of the stage.
    """

    render: Tensor
    target: Tensor
    alpha: Tensor
    mask: Tensor
    features: Tensor | None = None
    pose_features: Tensor | None = None
    pose_detail: Tensor | None = None
    to_neighbours: Tensor | None = None
    offsets: Tensor | None = None
    scales: Tensor | None = None
    motion: MotionState | None = None
    progress: float = 0.0


@dataclasses.dataclass
class LossConfig:
    """Options that every loss has.

    weight: factor in the total; 0 switches the loss off. start: progress in [0, 1] before which it is not evaluated.
    decay, decay_every: the weight is multiplied by `decay` each time progress passes a multiple of `decay_every`.
    """

    weight: float = 1.0
    start: float = 0.0
    decay: float = 1.0
    decay_every: float = 0.1

    def weight_at(self, progress: float) -> float:
        """The weight at `progress` of the stage; 0 before `start`."""
        if progress < self.start:
            return 0.0
        # an epoch boundary such as 3 * 0.1 must not fall below its own multiple
        return self.weight * self.decay ** math.floor(progress / self.decay_every + 1e-9)


class Loss(Protocol):
    """A component of `LOSSES`."""

    config: LossConfig

    def __call__(self, inputs: LossInputs) -> Tensor | None: ...


class LossComposer:
    """The weighted sum of the losses named in `losses`.

    losses: name -> weight, or name -> {weight, ...options of that loss}. A loss of weight zero is neither built nor
    evaluated. Raises UserError for an unknown loss or option and for a weight that is not a number >= 0.
    """

    def __init__(self, losses: Mapping[str, float | Mapping[str, Any]]):
        load_plugins()
        self.losses: dict[str, Loss] = {}
        for name, value in losses.items():
            config = loss_config(str(name), value)
            if config.weight > 0:
                self.losses[str(name)] = LOSSES[name].factory(config)
        if not self.losses:
            raise UserError("losses: no loss has a weight above zero, name at least one, for example losses.l1=0.8")

    def __call__(self, inputs: LossInputs) -> tuple[Tensor, dict[str, float]]:
        """The total (scalar, differentiable) and the unweighted value of each loss that was evaluated.

        When every loss abstains the total is a zero without gradient and the dictionary is empty.
        """
        values: dict[str, Tensor] = {}
        total = inputs.render.new_zeros(())
        for name, loss in self.losses.items():
            weight = loss.config.weight_at(inputs.progress)
            value = loss(inputs) if weight > 0 else None
            if value is not None:
                total = total + weight * value
                values[name] = value.detach()
        # one transfer from the device for all values
        numbers = torch.stack(list(values.values())).tolist() if values else []
        return total, dict(zip(values, numbers, strict=True))


def judging_poses(losses: Mapping[str, float | Mapping[str, Any]]) -> dict[str, float | Mapping[str, Any]]:
    """Those of the composed losses by which poses can be fitted to images."""
    kept = {}
    for name, value in losses.items():
        traits: LossTraits = LOSSES[name].traits(loss_config(name, value))
        if traits.judges_poses:
            kept[name] = value
    return kept


def loss_config(name: str, value: float | Mapping[str, Any] | None) -> LossConfig:
    """The filled options of loss `name`, checked."""
    if isinstance(value, Mapping) or value is None:
        config = LOSSES.options(name, value)
    else:
        config = LOSSES.options(name, {"weight": value})
    for field, low, high in (("weight", 0, math.inf), ("start", 0, 1), ("decay", 0, math.inf)):
        _check_number(f"losses.{name}.{field}", getattr(config, field), low, high)
    if not (isinstance(config.decay_every, int | float) and config.decay_every > 0):
        raise UserError(f"losses.{name}.decay_every: must be a number above 0, not {config.decay_every!r}")
    return config


def _check_number(field: str, value: Any, low: float, high: float) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not (number and low <= value <= high):
        bound = f"at least {low}" if math.isinf(high) else f"between {low} and {high}"
        raise UserError(f"{field}: must be a number {bound}, not {value!r}")


def check_choice(field: str, value: str, choices: tuple[str, ...]) -> None:
    """UserError naming `field` and the choices unless `value` is one of them."""
    if value not in choices:
        raise UserError(f"{field}: must be one of {', '.join(choices)}, not {value!r}")


def check_size(field: str, value: int) -> None:
    """UserError naming `field` unless `value` is a whole number of pixels, or 0."""
    if not (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        raise UserError(f"{field}: must be a whole number of pixels, or 0 for no limit, not {value!r}")


def step_seed(progress: float) -> int:
    """A seed for a loss that draws at random: a function of the step alone, so that a resumed run draws the same."""
    return round(progress * 2**40)
