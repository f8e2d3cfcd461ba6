"""The typed configuration of training, composed by Hydra and checked before any work starts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_module
from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf

from gavatar_runtime.errors import UserError

from .avatar.atlas import check_resolution
from .avatar.points import check_count
from .avatar.trainable import AvatarConfig
from .losses import loss_config
from .registry import BODIES, DECODERS, ENCODERS, POINTS, RASTERIZERS, fill_config_store, load_plugins

PRECISIONS = ("auto", "float32", "bfloat16")
DYNAMICS = ("always", "auto")
# settings of earlier versions, and what became of them
FORMER_SETTINGS = {
    "fill_unseen": "parts that were hardly filmed always take on what is around them",
    "mask_edge": "masks that are measured to be too wide are found anew (mask_matte)",
    "encoder_from": "the pose encoder learns in stage 2",
}
AUTO = "auto"  # of a remedy: decided by what is measured on the footage
DRAWS = ("new", "alike")


@dataclasses.dataclass
class LevelConfig:
    """One level of coarse-to-fine training. until: fraction of the stage at which it ends. gaussians: how many there
    are; uv: instead, as many as the body's atlas of this side has texels. image: scale of the images."""

    until: float = 1.0
    gaussians: int | None = None
    uv: int | None = None
    image: float = 1.0


@dataclasses.dataclass
class StageConfig:
    """One training stage. steps: optimiser steps (0 skips the stage). batch: views a step. lr_*: learning rates.
    lr_final: the last rate as a fraction of the first, reached by a cosine. levels: coarse to fine. In stage 2
    lr_features is 0 unless asked for: the feature tensor is frozen, as published; with lr_decoder 0 too all texture is.
    """

    steps: int = 1000
    batch: int = 4
    lr_decoder: float = 3e-3
    lr_features: float = 2e-2
    lr_encoder: float = 1e-3
    lr_final: float = 0.05
    levels: list[LevelConfig] = dataclasses.field(default_factory=lambda: [LevelConfig(gaussians=10_000)])


@dataclasses.dataclass
class MotionConfig:
    """How the body motion is optimised. enabled: off gives the paper's baseline. lr: radians a step;
    lr_trans: metres a step. start, end: fractions of the stage between which it is optimised. joints: how many of the
    first joints are corrected. sharing: seconds over which neighbouring frames are corrected alike at the start (the
    standard deviation of `gavatar.training.motion_table.shared_frames`; 0: each frame learns from its own images
    alone; never more than an eighth of the time that the training frames cover); sharing_final: what it narrows to at
    the fraction sharing_end of the stage. guard: at the end of the stage, frames whose refined pose renders worse than
    the estimated one get their estimate back. mend: fraction of the stage at which frames that another pose (their
    estimate, or one made from it or from their neighbours) renders better by far get that pose; 0: never. betas:
    the shape coefficients are optimised too, one vector for the capture, at the rate lr_betas (standard deviations
    a step). stage2, stage2_trans: factors on lr and lr_trans in stage 2, 0 to leave the poses as stage 1 refined
    them, as published.

    `auto`: start and betas are chosen by what is measured on the footage (`gavatar.training.choosing`); sharing is 0.8
    seconds, and mend is at a fifth of the stage."""

    enabled: bool = True
    lr: float = 1.0e-2
    lr_trans: float = 4.0e-3
    start: Any = AUTO
    end: float = 1.0
    joints: int = 22
    sharing: Any = AUTO
    sharing_final: float = 0.0
    sharing_end: float = 0.7
    guard: bool = True
    mend: Any = AUTO
    betas: Any = AUTO
    lr_betas: float = 1.0e-2
    stage2: float = 0.0
    stage2_trans: float = 0.0


@dataclasses.dataclass
class TrainConfig:
    """Everything a run needs. capture: directory. out: run directory. train_split: of the capture, what is trained on.
    background: `random` colour each step, `white`
    or `black`. crop: render only the window in which the person moves. preview_every, checkpoint_every: steps.
    minutes: that training may take here, 0 for the preset's steps: a few steps are timed first, then the steps of both
    stages are scaled.
    precision: of the decoder's products while training, `float32`, `bfloat16` or `auto`, the faster one here.
    draw: while the pose encoder learns, views are drawn by how `new` their pose is, so that one that recurs counts
    little more than once, or all `alike`.
    overwrite: start afresh even if `out` holds another run. mask_matte: pixels
    inside the border of every mask, or below zero outside it, in which it is found anew from the footage's colours,
    where masks are too wide or too narrow. exposure:
    learn a gain for every training view, where the footage's brightness drifts. Both are `auto`: measured on the
    footage and chosen by that.
    dynamics: `always` keeps what stage 2 learns; `auto` only if it gains `dynamics_gain` dB on training views in poses
    that the pose encoder did not learn from, the worst of them and the perceptual distance are no worse, and detail
    stays in a motion that nobody filmed: else the avatar is static."""

    capture: str = MISSING
    out: str = MISSING
    seed: int = 0
    device: str = "auto"
    threads: int = 0
    minutes: float = 0.0
    precision: str = "float32"
    overwrite: bool = False
    background: str = "random"
    crop: bool = True
    train_split: str = "train"
    draw: str = "new"
    mask_matte: Any = AUTO
    exposure: Any = AUTO
    dynamics: str = "auto"
    dynamics_gain: float = 0.1
    preview_every: int = 200
    checkpoint_every: int = 100
    tensorboard: bool = False
    progress: bool = True
    body: Any = MISSING
    points: Any = MISSING
    encoder: Any = MISSING
    decoder: Any = MISSING
    rasterizer: Any = MISSING
    capture_format: Any = MISSING
    avatar: AvatarConfig = dataclasses.field(default_factory=AvatarConfig)
    motion: MotionConfig = dataclasses.field(default_factory=MotionConfig)
    stage1: StageConfig = dataclasses.field(default_factory=StageConfig)
    stage2: StageConfig = dataclasses.field(default_factory=lambda: StageConfig(lr_features=0.0))
    losses: dict[str, Any] = dataclasses.field(default_factory=dict)


def register_configs() -> None:
    """Load the plugins and put the schema and every component into Hydra's ConfigStore."""
    load_plugins()
    fill_config_store()
    OmegaConf.register_new_resolver("capture_name", lambda path: Path(str(path)).resolve().name, replace=True)
    ConfigStore.instance().store(name="train_schema", node=TrainConfig, provider="gavatar")


def compose_config(overrides: Sequence[str]) -> DictConfig:
    """What `gavatar-train OVERRIDES` would train, composed without starting Hydra's application."""
    register_configs()
    with initialize_config_module("gavatar.conf", version_base="1.3"):
        return compose("train", overrides=list(overrides))


def check(config: DictConfig) -> TrainConfig:
    """The composed configuration as dataclasses, every value checked; UserError names the field that is wrong."""
    if OmegaConf.is_missing(config, "capture"):
        raise UserError("no capture given: add capture=DIR (for a first try: gavatar-demo)")
    plain: Any = OmegaConf.to_container(config, resolve=True)
    fields = {f.name for f in dataclasses.fields(TrainConfig)}
    former = {"name": POINTS.having(former=True)[0]}  # of runs that do not say where their points are
    typed = TrainConfig(**{"points": former} | {k: v for k, v in plain.items() if k in fields})
    typed.avatar = AvatarConfig(**plain["avatar"])
    typed.motion = MotionConfig(**plain["motion"])
    for stage in ("stage1", "stage2"):
        values = {key: value for key, value in plain[stage].items() if key not in FORMER_SETTINGS}
        values["levels"] = [LevelConfig(**level) for level in values["levels"]]
        setattr(typed, stage, StageConfig(**values))
        _check_stage(stage, getattr(typed, stage))
    for registry in (BODIES, POINTS, ENCODERS, DECODERS, RASTERIZERS):
        node = getattr(typed, registry.group)
        registry.options(node["name"], node)
    for name, value in typed.losses.items():
        loss_config(name, value)
    if typed.background not in ("random", "white", "black"):
        raise UserError(f"background must be random, white or black, not '{typed.background}'")
    if typed.draw not in DRAWS:
        raise UserError(f"draw must be {' or '.join(DRAWS)}, not '{typed.draw}'")
    if not (typed.mask_matte == AUTO or is_number(typed.mask_matte)):
        raise UserError(f"mask_matte must be auto or a number of pixels, not {typed.mask_matte!r}")
    if not (is_number(typed.minutes) and typed.minutes >= 0):
        raise UserError(f"minutes must be a number of at least 0, not {typed.minutes!r}")
    check_choice("exposure", typed.exposure)
    check_precision(typed.precision)
    check_dynamics(typed.dynamics, typed.dynamics_gain)
    check_motion(typed.motion)
    return typed


def check_motion(motion: MotionConfig) -> None:
    """UserError naming the field unless every number is possible."""
    for field in (
        "lr", "lr_trans", "lr_betas", "sharing", "sharing_final", "sharing_end", "mend", "stage2", "stage2_trans"
    ):  # fmt: skip
        value, chooses = getattr(motion, field), field in ("sharing", "mend")
        if chooses and value == AUTO:
            continue
        if not is_number(value) or value < 0 or (field in ("sharing_end", "mend") and value > 1):
            kind = "a fraction of the stage" if field in ("sharing_end", "mend") else "a number of at least 0"
            raise UserError(f"motion.{field} must be {kind}{', or auto' if chooses else ''}, not {value!r}")
    check_choice("motion.betas", motion.betas)
    start = 0.0 if motion.start == AUTO else motion.start
    if not is_number(start) or not 0 <= start <= motion.end <= 1:
        raise UserError("motion.start and motion.end must be fractions with 0 <= start <= end <= 1, or start auto")


def is_number(value: Any) -> bool:
    """Whether `value` is a finite number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def check_choice(name: str, value: Any) -> None:
    """UserError unless `value` is true, false or auto."""
    if not (isinstance(value, bool) or value == AUTO):
        raise UserError(f"{name} must be true, false or auto, not {value!r}")


def _check_stage(name: str, stage: StageConfig) -> None:
    if stage.steps < 0 or stage.batch < 1:
        raise UserError(f"{name}.steps must be at least 0 and {name}.batch at least 1")
    if not stage.levels:
        raise UserError(f"{name}.levels must list at least one level")
    ends = [level.until for level in stage.levels]
    if ends != sorted(ends) or ends[-1] != 1.0 or ends[0] <= 0:
        raise UserError(f"{name}.levels: 'until' must rise to 1.0, not {ends}")
    for level in stage.levels:
        if (level.gaussians is None) == (level.uv is None):
            raise UserError(
                f"{name}.levels: each level has either 'gaussians', their number, or 'uv', a side of the atlas"
            )
        if level.uv is not None:
            check_resolution(level.uv, f"{name}.levels: uv")
        else:
            check_count(level.gaussians, f"{name}.levels: gaussians")
        if not 0 < level.image <= 4:
            raise UserError(f"{name}.levels: image must be within (0, 4], not {level.image}")


def check_precision(precision: str) -> None:
    """UserError unless `precision` is one of the choices."""
    if precision not in PRECISIONS:
        raise UserError(f"precision must be {', '.join(PRECISIONS[:-1])} or {PRECISIONS[-1]}, not '{precision}'")


def check_dynamics(dynamics: str, least_gain: float) -> None:
    """UserError unless both options are possible."""
    if dynamics not in DYNAMICS:
        raise UserError(f"dynamics must be {' or '.join(DYNAMICS)}, not '{dynamics}'")
    if not math.isfinite(least_gain):
        raise UserError(f"dynamics_gain must be a number of decibels, not {least_gain}")
