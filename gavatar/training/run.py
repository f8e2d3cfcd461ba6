"""Run directories: starting, resuming and opening them."""

from __future__ import annotations

import dataclasses
import os
import warnings
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from gavatar_runtime.errors import UserError
from gavatar_runtime.notes import Note
from gavatar_runtime.values.motion import Motion

from ..assemble import AvatarBuild, build_configured, capture_on_body, resolve_body
from ..avatar.trainable import Avatar
from ..capture.capture import Capture, View
from ..capture.fingerprint import fingerprint
from ..capture.opening import open_capture
from ..config import TrainConfig, check
from ..registry import RASTERIZERS, split_node
from ..storage import load_tensors
from .budget import within
from .motion_table import MotionTable
from .places import CONFIG, WrittenRun, absolute, from_here
from .remedies.placed_evidence import PlacedEvidence
from .stage import REFUSED, STAGE_FILES
from .trainer import Trainer, resolved


def train(composed: DictConfig, directory: Path) -> Trainer:
    """Train in `directory`: a new run, or the continuation of one of the same configuration.

    Raises UserError before any work when the configuration is wrong, or when the directory holds a run of another
    configuration and overwrite is off.
    """
    config, directory = absolute(check(composed)), Path(directory)
    opened = open_capture(config.capture, config.capture_format)
    # what `auto` finds today is written down: another day it may find other files
    config.body = resolve_body(config.body, opened)
    content = fingerprint(opened, config.train_split)
    continued = (directory / CONFIG).exists() and not config.overwrite
    if continued:
        written = WrittenRun.read(directory)
        if config.minutes and written.config.minutes == config.minutes:  # as they were measured at its start
            config.stage1.steps, config.stage2.steps = written.config.stage1.steps, written.config.stage2.steps
        refuse_another(written, config, content)
    trainer = Trainer(config, directory)  # everything that can be wrong is found before the old run is touched
    if config.minutes and not continued:
        config = within(config)
        trainer = Trainer(config, directory)
        steps = config.stage1.steps, config.stage2.steps
        warnings.warn(f"{config.minutes:g} minutes: {steps[0]} steps in stage 1, {steps[1]} in stage 2", Note)
    if config.overwrite:
        for name in ("checkpoint.pt", "metrics.json", "motion.npz", REFUSED, *STAGE_FILES.values()):
            (directory / name).unlink(missing_ok=True)
    directory.mkdir(parents=True, exist_ok=True)
    WrittenRun(directory, config, from_here(config, directory), content).write()
    trainer.run()
    return trainer


def refuse_another(written: WrittenRun, config: TrainConfig, content: str) -> None:
    """UserError naming what differs unless a run directory holds a run of this configuration and of this capture."""
    changed = differences(resolved(written.recognised(config, content)), resolved(config))
    if changed:
        raise UserError(
            f"{written.directory} holds a run with another {', '.join(changed)}: choose another out=DIR, or "
            "overwrite=true to start afresh"
        )
    if written.content and written.content != content:
        raise UserError(
            f"{config.capture} does not hold what {written.directory} was trained on, images, masks, cameras or poses "
            "have changed: choose another out=DIR, or overwrite=true to start afresh"
        )


def differences(former: dict[str, Any], now: dict[str, Any], above: str = "") -> list[str]:
    """The settings that differ, by their whole names, with what they were and are where that is one value. Of another
    component only its name is told."""
    names = former.get("name"), now.get("name")
    if names[0] != names[1]:
        return [f"{above.removesuffix('.')} ({names[0]}, now {names[1]})"]
    found = []
    for key in now | former:
        one, other = former.get(key), now.get(key)
        if isinstance(one, dict) and isinstance(other, dict):
            found += differences(one, other, f"{above}{key}.")
        elif one != other:
            plain = not isinstance(one, dict | list) and not isinstance(other, dict | list)
            found.append(f"{above}{key}" + (f" ({one}, now {other})" if plain else ""))
    return found


@dataclasses.dataclass
class Run:
    """A trained run, opened. stage: of the avatar that was loaded. pixel: metres of
    the person that a pixel of the training images spanned (`gavatar_runtime.decoding.detail.as_trained`).
    evidence: what the training views say of the body's points, None of runs of earlier versions."""

    directory: Path
    config: TrainConfig
    capture: Capture
    built: AvatarBuild
    motion: MotionTable
    stage: int
    pixel: float | None = None
    evidence: PlacedEvidence | None = None

    @property
    def avatar(self) -> Avatar:
        return self.built.avatar


def open_run(
    directory: str | os.PathLike[str], stage: int | None = None, capture: str | os.PathLike[str] | None = None
) -> Run:
    """Open a finished run for evaluation or export; the avatar is in eval mode on the CPU.

    stage: 1 or 2, by default the last that was trained. capture: where the footage is now, if it has moved.
    Raises UserError when the directory is no run or the stage was never finished.
    """
    directory = Path(directory)
    if not (directory / CONFIG).exists():
        raise UserError(f"{directory} is not a run directory: it has no {CONFIG} (gavatar-train writes one)")
    config = WrittenRun.read(directory).found()
    if capture is not None:
        config.capture = str(capture)
    finished = [n for n, name in STAGE_FILES.items() if (directory / name).exists()]
    if not finished:
        raise UserError(f"{directory} has no finished stage yet: give the gavatar-train command again to continue it")
    number = stage or max(finished)
    if number not in finished:
        raise UserError(f"{directory} has no stage {number}; finished: {', '.join(map(str, finished))}")
    state = load_tensors(directory / STAGE_FILES[number])
    config.mask_matte = state.get("mask_matte", config.mask_matte)  # as it was chosen, where it was left to auto
    opened = open_capture(config.capture, config.capture_format)
    built = build_configured(config, opened)
    if "betas" in state:
        built.reshape(state["betas"].numpy())
    opened = capture_on_body(opened, built.body.data)
    motion = MotionTable(opened.motion, built.body.data.num_joints, config.motion.joints)
    motion.betas = built.betas
    try:
        built.avatar.load_state_dict(state["avatar"])
        motion.load_state_dict(state["motion"])
    except (RuntimeError, KeyError) as error:
        cause = " ".join(line.strip() for line in str(error).splitlines()[:2])  # the second names the first fault
        raise UserError(f"{directory / STAGE_FILES[number]} does not fit {CONFIG} or the capture: {cause}") from None
    if number == 1:
        built.avatar.encoder = None
    # runs of former versions tell the side of the atlas
    built.avatar.sample_at(built.surface(state["gaussians"] if "gaussians" in state else len(built.atlas(state["uv"]))))
    built.avatar.eval()
    for parameter in [*built.avatar.parameters(), *motion.parameters()]:
        parameter.requires_grad_(False)
    pixel = None
    if RASTERIZERS.traits(*split_node(config.rasterizer)).widens:
        scale = getattr(config, f"stage{number}").levels[-1].image
        pixel = finest_pixel(opened, opened.views(config.train_split), scale, motion.motion())
    evidence = None
    if "evidence" in state:
        evidence = PlacedEvidence.from_state(state["evidence"], str(directory / STAGE_FILES[number]))
    return Run(directory, config, opened, built, motion, state["stage"], pixel, evidence)


def finest_pixel(capture: Capture, views: list[View], scale: float, motion: Motion) -> float | None:
    """Metres that a pixel of the images, scaled by `scale`, spans at the person's place, in the nearest of the views;
    None where nobody stands before a camera."""
    spans = []
    for view in views:
        camera = capture.camera(view)
        depth = camera.T_camera_world[2, :3] @ motion.trans[view.frame] + camera.T_camera_world[2, 3]
        spans.append(2 * depth / (camera.fx + camera.fy) / scale)
    return float(min((span for span in spans if span > 0), default=0)) or None
