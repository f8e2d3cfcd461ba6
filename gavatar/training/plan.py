"""What each stage of a training does (paper, section 4.3), as a value."""

from __future__ import annotations

import dataclasses
import math

from ..config import AUTO, LevelConfig, MotionConfig, StageConfig, TrainConfig
from .schedule import SHARED, sharing_width

PRIOR_AT = 0.75  # of a stage's steps


@dataclasses.dataclass(frozen=True)
class Plan:
    """One stage: what learns in it, at what rates and on what images, and which remedies it applies.

    stage: steps, batch, rates and levels. seed, background: of the views it draws and what lies behind them. draws_new:
    while the pose encoder learns, it draws views by how new their pose is, else each alike.
    preview_every, save_every: steps.

    What learns. dynamic: the avatar is drawn with the pose encoder, and it learns. learns_decoder, learns_features,
    learns_exposure, learns_shape: true where it does. poses_move: the poses are refined, by pose_rates in radians and
    metres a step, within the fractions `window` of the stage, with the options `motion`. narrowing: neighbouring
    frames share less and less of their corrections, else as little as at the end of a stage that narrows.

    Remedies. Before exposure_step and shape_step it is decided whether these are learnt, None where that is settled.
    waits: when poses begin to move is decided before all. mend_step: before which outliers are mended, None for never.
    prior_step: before which points that were hardly seen take on what is around them, to be held there; None for never.
    guard: poses that got worse are refused. leaves_out: some views are kept from the pose encoder. least_gain: dB that
    dynamics must gain on them to be kept, None where they are kept unasked; static_level: the last of the avatar that
    they must surpass.
    """

    number: int
    stage: StageConfig
    motion: MotionConfig
    seed: int
    background: str
    draws_new: bool
    dynamic: bool
    learns_decoder: bool
    learns_features: bool
    learns_exposure: bool
    learns_shape: bool
    poses_move: bool
    pose_rates: tuple[float, float]
    window: tuple[float, float]
    narrowing: bool
    mend_step: int | None
    exposure_step: int | None
    shape_step: int | None
    waits: bool
    prior_step: int | None
    guard: bool
    leaves_out: bool
    least_gain: float | None
    static_level: LevelConfig
    preview_every: int
    save_every: int

    def poses_move_at(self, progress: float) -> bool:
        """Whether poses are refined at `progress`, 0 to 1, of the stage."""
        return self.poses_move and self.window[0] <= progress <= self.window[1]

    def sharing(self, progress: float, span: float) -> float:
        """Seconds over which the frames of a capture of `span` seconds share their corrections."""
        return sharing_width(self.motion, progress if self.narrowing else 1.0, span)

    @property
    def image(self) -> float:
        """Scale of the images that the stage ends with."""
        return self.stage.levels[-1].image


# fractions of stage 1: brightness is told by colours that are about right; whether a pose or a shape is wrong, by an
# avatar that is one
EXPOSURE_AT, MEND_AT, SHAPE_AT = 0.1, 0.2, 0.1
SHAPE_AFTER, LEAST_STEPS = 50, 200  # steps: an avatar of a few gains by any shape, and short trainings have no other


def settled(motion: MotionConfig) -> MotionConfig:
    """The options with the words `auto` that need no look at the footage replaced by numbers."""
    mend = MEND_AT if motion.mend == AUTO else motion.mend
    sharing = SHARED if motion.sharing == AUTO else motion.sharing
    return dataclasses.replace(motion, mend=mend, sharing=sharing, start=0.0 if motion.start == AUTO else motion.start)


def stage_plans(config: TrainConfig, dynamic: bool) -> list[Plan]:
    """The stages of a training. dynamic: the avatar has a pose encoder."""
    dynamic = dynamic and config.stage2.steps > 0
    plans = [appearance(config, dynamic)]
    if dynamic:
        plans.append(dynamics(config))
    return plans


def prior_step(stage: StageConfig) -> int | None:
    """The step from which on a stage holds to the prior what was hardly seen: with all points in place and a quarter
    of the steps to go, or what the last level has; None of a stage without steps."""
    if not stage.steps:
        return None
    starts = [0.0, *(level.until for level in stage.levels[:-1])][-1]
    return min(max(round(PRIOR_AT * stage.steps), math.ceil(starts * stage.steps)), stage.steps - 1)


def appearance(config: TrainConfig, dynamic: bool = False) -> Plan:
    """Stage 1: how the person looks, and how they move. dynamic: stage 2 follows."""
    motion, steps = settled(config.motion), config.stage1.steps
    mends = motion.enabled and motion.mend > 0
    tries_shape = motion.enabled and motion.betas == AUTO and steps >= LEAST_STEPS

    def step_at(fraction: float, wanted: bool) -> int | None:
        return max(0, min(round(fraction * steps), steps - 1)) if wanted else None

    return Plan(
        number=1,
        stage=config.stage1,
        motion=motion,
        seed=config.seed + 1,
        background=config.background,
        draws_new=config.draw == "new",
        dynamic=False,
        learns_decoder=True,
        learns_features=True,
        learns_exposure=config.exposure is True,
        learns_shape=motion.enabled and motion.betas is True,
        poses_move=motion.enabled,
        pose_rates=(motion.lr, motion.lr_trans),
        window=(motion.start, motion.end),
        narrowing=True,
        mend_step=step_at(motion.mend, mends),
        exposure_step=step_at(EXPOSURE_AT, config.exposure == AUTO),
        shape_step=max(SHAPE_AFTER, round(SHAPE_AT * steps)) if tries_shape else None,
        waits=motion.enabled and config.motion.start == AUTO,
        prior_step=prior_step(config.stage1),
        guard=motion.guard,
        leaves_out=dynamic and config.dynamics == "auto",
        least_gain=None,
        static_level=config.stage1.levels[-1],
        preview_every=config.preview_every,
        save_every=config.checkpoint_every,
    )


def dynamics(config: TrainConfig) -> Plan:
    """Stage 2: how the look hangs on the pose."""
    motion = settled(config.motion)
    return Plan(
        number=2,
        stage=config.stage2,
        motion=motion,
        seed=config.seed + 2,
        background=config.background,
        draws_new=config.draw == "new",
        dynamic=True,
        learns_decoder=config.stage2.lr_decoder > 0,
        learns_features=config.stage2.lr_features > 0,
        learns_exposure=False,
        learns_shape=False,
        poses_move=motion.enabled and max(motion.stage2, motion.stage2_trans) > 0,
        pose_rates=(motion.stage2 * motion.lr, motion.stage2_trans * motion.lr_trans),
        window=(0.0, 1.0),
        narrowing=False,
        mend_step=None,
        exposure_step=None,
        shape_step=None,
        waits=False,
        # a look that stands still was held to the prior in stage 1
        prior_step=prior_step(config.stage2) if config.stage2.lr_decoder or config.stage2.lr_features else None,
        guard=motion.guard,
        leaves_out=config.dynamics == "auto",
        least_gain=config.dynamics_gain if config.dynamics == "auto" else None,
        static_level=config.stage1.levels[-1],
        preview_every=config.preview_every,
        save_every=config.checkpoint_every,
    )
