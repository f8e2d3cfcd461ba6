"""gavatar from Python::

    import gavatar

    capture = gavatar.prepare("clip.mp4", "captures/anna", height=1.72)
    run = gavatar.train(capture, preset="demo", encoder="none", out="runs/anna")
    print(run.evaluate())
    run.export("anna.gavatar", tiers="auto")

The commands do what these functions do. A mistake of the caller's is a UserError of one sentence.
"""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import torch

from gavatar_runtime.bundle import Manifest
from gavatar_runtime.conversions import CONVERSIONS, convert
from gavatar_runtime.decoding.detail import count_for_footage
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.motions import read_motion
from gavatar_runtime.notes import Note
from gavatar_runtime.play.defaults import AUTO
from gavatar_runtime.tiers import PLAYER_TIERS
from gavatar_runtime.values.motion import Motion

from .capture import opening
from .capture.capture import Capture
from .config import TrainConfig, check, register_configs
from .evaluation.dynamics import weigh_dynamics
from .evaluation.result import Evaluation
from .evaluation.scores import evaluate
from .export.bundling import export, export_front
from .overrides import as_overrides, check_overrides
from .preparation.from_footage import PreparedCapture, prepare
from .registry import load_plugins
from .training import run as runs

__all__ = ["ExportedAvatar", "PreparedCapture", "TrainedRun", "open_capture", "open_run", "prepare", "train"]

PathLike = str | os.PathLike[str]


def open_capture(path: PathLike) -> Capture:
    """The capture in a folder, of any layout that gavatar reads. Raises UserError for anything else."""
    load_plugins()
    return opening.open_capture(path)


def train(
    capture: PathLike | Capture,
    preset: str = "default",
    *,
    out: PathLike | None = None,
    **overrides: Any,
) -> TrainedRun:
    """Train an avatar of a capture; a run that `out` holds and that was stopped is continued.

    capture: a folder, or what `prepare` or `open_capture` gave. preset: of those in docs/reference/presets.md. out: the
    run's folder, by default runs/NAME of the capture. overrides: any setting of `gavatar-train`, written
    `encoder="none"`, `stage1={"steps": 50}`, `body={"name": "smplx", "path": "models"}`, or with its whole name as
    `**{"stage1.steps": 50}`.

    Raises UserError, before any work, for a setting that is unknown or wrong, and when `out` holds another run.
    """
    register_configs()
    given = {"capture": capture.path if isinstance(capture, Capture) else Path(capture), "experiment": preset}
    if out is not None:
        given["out"] = Path(out)
    (composed,) = check_overrides(as_overrides(given | overrides))
    directory = Path(check(composed).out)
    runs.train(composed, directory)
    return open_run(directory)


def open_run(directory: PathLike, stage: int | None = None, capture: PathLike | None = None) -> TrainedRun:
    """A run that was trained. stage: 1 or 2, by default the last one finished. capture: where the footage is now, if
    it has moved. Raises UserError where there is none."""
    register_configs()
    return TrainedRun(runs.open_run(directory, stage, capture))


class TrainedRun:
    """A trained avatar with the capture that it was learnt from.

    opened: everything of it as PyTorch modules. directory: its folder. stage: 1 before dynamics were learnt, else 2.
    """

    def __init__(self, opened: runs.Run):
        self.opened = opened

    def __repr__(self) -> str:
        kind = "dynamic" if self.dynamic else "static"
        return f"<TrainedRun {self.directory}: stage {self.stage}, {self.gaussians:,} Gaussians, {kind}>"

    @property
    def directory(self) -> Path:
        return self.opened.directory

    @property
    def stage(self) -> int:
        return self.opened.stage

    @property
    def config(self) -> TrainConfig:
        """The configuration that it was trained with."""
        return self.opened.config

    @property
    def capture(self) -> Capture:
        return self.opened.capture

    @property
    def gaussians(self) -> int:
        return len(self.opened.avatar.surface)

    @property
    def dynamic(self) -> bool:
        """Whether its look depends on the pose."""
        return self.opened.avatar.encoder is not None

    @property
    def metrics(self) -> dict[str, Any]:
        """What training wrote down: seconds, losses as `history`, what its remedies decided as `verdicts`."""
        return json.loads((self.directory / "metrics.json").read_text(encoding="utf-8"))

    def evaluate(
        self,
        splits: Sequence[str] | None = None,
        *,
        fit_steps: int = 60,
        perceptual: bool = True,
        rasterizer: str | None = None,
        device: str | torch.device = "cpu",
        dynamics: bool = True,
        progress: bool = True,
    ) -> Evaluation:
        """Image and joint errors against the footage, split by split, and whether dynamics are worth their cost.

        splits: default all of the capture. fit_steps: of fitting held-out poses, 0 leaves those rows out. perceptual:
        with the perceptual distance. rasterizer: to draw with, default the run's. dynamics: with the verdict on them,
        for which held-out views are drawn once more. Raises UserError for a wrong name.
        """
        run = runs.open_run(self.directory, self.stage, self.config.capture)  # its avatar moves to the device
        if rasterizer is not None:
            run.config.rasterizer = {"name": rasterizer}
        result = evaluate(run, splits, fit_steps, perceptual, progress, device)
        if dynamics:
            result.dynamics = weigh_dynamics(result, device)
        return result

    def export(
        self,
        out: PathLike | None = None,
        *,
        tiers: str | Sequence[str] = (),
        gaussians: int | Literal["auto"] | None = None,
        drop_unseen: bool = False,
        poses: int = 8,
        progress: bool = False,
        uv: int | None = None,
        motions: Sequence[str | Path | Motion] | None = None,
    ) -> ExportedAvatar:
        """Write the avatar as a bundle that plays without PyTorch.

        out: NAME.gavatar, by default of the capture's name in the run's folder; or NAME.html and what else
        `avatar.convert` writes to a file, from a bundle that is not kept. tiers: cheaper ways to decode it, names
        or "auto" for those that pay on this machine. gaussians: how many, "auto" for as many as the footage's pixels
        are worth and no more than were trained, None for these. drop_unseen: leave out Gaussians that no training view
        sees nor any neighbour within 2 cm. poses: of the capture that it is verified on. motions: of what is no bundle,
        built-in ones and files, the first plays at the start; as `avatar.convert` chooses them if None. uv: the former
        way to say `gaussians`, as the side of an atlas with so many texels on the body.

        Raises UserError, and writes nothing, unless positions agree with PyTorch within 0.1 mm and colours within
        1/255.
        """
        path = Path(out) if out is not None else self.directory / f"{self.capture.name}.gavatar"
        count = self._count(gaussians, uv)
        if path.suffix != ".gavatar":
            more = {"gaussians": count, "drop_unseen": drop_unseen, "poses": poses, "progress": progress}
            return self._exported_elsewhere(path, tiers, motions, **more)
        if motions is not None:
            raise WrongValue("`motions` is of web pages: a bundle holds none, whoever plays it chooses them")
        if poses < 1:
            raise WrongValue(f"`poses={poses}`: give at least 1, an export that is not verified is not written")
        names = [name.strip() for name in tiers.split(",") if name.strip()] if isinstance(tiers, str) else list(tiers)
        how: dict[str, Any] = {"gaussians": count, "drop_unseen": drop_unseen, "progress": progress}
        if names == ["auto"]:
            manifest = export_front(self.opened, path, poses, **how)
        else:
            manifest = export(self.opened, path, poses, tiers=names, **how)
        return ExportedAvatar(path, manifest)

    def _count(self, gaussians: int | str | None, uv: int | None) -> int | None:
        """How many Gaussians `export` is asked for, None for those that were trained."""
        if gaussians is not None and uv is not None:
            raise WrongValue("`gaussians` and `uv` both choose the level of detail: give one of them")
        if uv is not None:
            count = len(self.opened.built.atlas(uv))
            warnings.warn(f"`uv={uv}` is the former way to say `gaussians={count}`", Note, stacklevel=3)
            return count
        if gaussians == AUTO:
            return count_for_footage(self.opened.avatar.surface, self.opened.pixel)
        if isinstance(gaussians, str) or (gaussians is not None and gaussians < 1):
            raise WrongValue(f"`gaussians={gaussians}`: give a whole number from 1 up, or {AUTO}")
        return gaussians

    def _exported_elsewhere(
        self, path: Path, tiers: str | Sequence[str], motions: Sequence[str | Path | Motion] | None, **how: Any
    ) -> ExportedAvatar:
        """A file of another kind than a bundle, made of one with the tiers that can be played without networks."""
        if path.suffix.lower() not in (s for c in CONVERSIONS for s in c.kind.suffixes):
            raise UserError(
                f"{path}: a bundle's name ends in .gavatar, a web page's in .html (gavatar-list conversion)"
            )
        if motions is not None:  # one that cannot be read is told before the export
            motions = [motion if isinstance(motion, Motion) else read_motion(motion) for motion in motions]
        if not tiers and self.dynamic:
            tiers = PLAYER_TIERS.having(linear=True)
        with tempfile.TemporaryDirectory(prefix="gavatar-export-") as folder:
            bundle = self.export(Path(folder, f"{path.stem}.gavatar"), tiers=tiers, **how)
            for note in convert(bundle.path, path, motions=motions):
                warnings.warn(note, Note, stacklevel=3)
        return ExportedAvatar(path, bundle.manifest)


@dataclasses.dataclass(frozen=True)
class ExportedAvatar:
    """A bundle that was written, or what was made of one; manifest: of that bundle. It may be given wherever a path
    may, as in `gavatar_runtime.load(exported)`."""

    path: Path
    manifest: Manifest

    def __fspath__(self) -> str:
        return str(self.path)

    def __str__(self) -> str:
        return f"{self.path}: {summary(self.manifest, self.path.stat().st_size)}"


def summary(manifest: Manifest, size: int) -> str:
    """What a bundle of `size` bytes holds and how it was verified, for people."""
    check, unseen = manifest.export_check, manifest.training.get("unseen")
    lines = [
        f"{manifest.gaussians} Gaussians, {'dynamic' if manifest.dynamic else 'static'}, opset {manifest.opset}, "
        f"{size / 1e6:.1f} MB",
        f"verified on {check['poses']} poses: positions within {1000 * check['position_m']:.5f} mm, colours within "
        f"{255 * check['color']:.4f}/255 of PyTorch",
    ]
    if unseen is not None:
        lines.append(
            f"unseen: {unseen['dropped']} Gaussians left out; {unseen['psnr']:.1f} dB against all of them on "
            f"{unseen['views']} views held out, worst {unseen['worst_psnr']:.1f}"
        )
    lines += [
        f"tier {tier['name']}: {tier['psnr_capture']:.1f} dB against full on poses of the capture (worst "
        f"{tier['worst_psnr_capture']:.1f}), {tier['psnr_mixed']:.1f} dB on mixed ones, {tier['frame_ms']:.1f} ms "
        f"a frame of {tier['size']} pixels here"
        for tier in manifest.tiers
    ]
    return "\n".join(lines)
